"""A result takes the place of the earlier one, or the earlier one stays and the user is told what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from process.results.write import ResultWriteError, write_result


def test_a_failed_write_leaves_the_old_file_and_no_temporary_one(tmp_path: Path) -> None:
    target = tmp_path / "cloud.ply"
    target.write_text("old")

    def write(temporary: Path) -> None:
        temporary.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(ResultWriteError, match=r"cannot write .*cloud\.ply: No space left"):
        write_result(target, write)
    assert [path.name for path in tmp_path.iterdir()] == ["cloud.ply"]
    assert target.read_text() == "old"


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(ResultWriteError, match="gone"):
        write_result(tmp_path / "gone" / "cloud.ply", b"x")
