"""The command that makes a board to print."""

from __future__ import annotations

from click.testing import CliRunner

from tui.cli import cli


def test_a_board_is_written_once(tmp_path):
    arguments = ["board", "--pdf", str(tmp_path / "board.pdf")]
    first = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert "--kind charuco --dictionary DICT_5X5" in first.output
    assert (tmp_path / "board.pdf").read_bytes().startswith(b"%PDF")
    again = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert "exists already" in str(again.exception)


def test_a_folder_that_is_not_there_is_named(tmp_path):
    result = CliRunner().invoke(cli, ["board", "--pdf", str(tmp_path / "no" / "board.pdf")], standalone_mode=False)
    assert "cannot write" in str(result.exception) and "No such file" in str(result.exception)
