"""Kernels are kept on disk, and compiled again when anything changes that they are made of."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from numba import njit

from acquire.contract.process import kernel_cache
from tests import ROOT

_OUTER = """
from pathlib import Path
from acquire.contract.process.kernel_cache import digest_of, kernel_decorator
from inner import TYPE, value

@kernel_decorator(digest_of(Path(__file__).parent.glob("*.py")))
def outer(given):
    return given.x + value()

print(outer(TYPE(1)), sum(outer.stats.cache_hits.values()))
"""
_INNER = """
from typing import NamedTuple
from numba import njit

class TYPE(NamedTuple):
    x: int

@njit
def value():
    return VALUE
"""


def run(folder: Path, value: int, type_name: str = "Sample") -> tuple[int, int]:
    """The kernel's result and how often it was taken from the cache, in a process of its own."""
    (folder / "outer.py").write_text(_OUTER.replace("TYPE", type_name))
    (folder / "inner.py").write_text(_INNER.replace("TYPE", type_name).replace("VALUE", str(value)))
    environ = {"PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", "PATH": ""}
    done = subprocess.run(
        [sys.executable, folder / "outer.py"], capture_output=True, text=True, env=environ, check=True
    )
    result, hits = done.stdout.split()
    return int(result), int(hits)


def test_a_kernel_is_compiled_once_and_again_when_a_file_that_it_calls_into_changes(tmp_path):
    assert run(tmp_path, value=10) == (11, 0)
    assert run(tmp_path, value=10) == (11, 1)
    assert run(tmp_path, value=20) == (21, 0)


def test_a_type_that_a_kernel_takes_may_be_renamed(tmp_path):
    assert run(tmp_path, value=10) == (11, 0)
    assert run(tmp_path, value=10, type_name="PixelSample") == (11, 0)


def _kept(folder: Path, suffix: str) -> list[Path]:
    return sorted(folder.rglob(f"*.{suffix}"))


@pytest.mark.parametrize("suffix", ["nbi", "nbc"])
@pytest.mark.parametrize("content", [b"", b"\x80\x04garbage", b"\0" * 4096], ids=["empty", "garbage", "zeros"])
def test_a_cache_that_a_power_cut_damaged_is_made_again(tmp_path, suffix, content):
    assert run(tmp_path, value=10) == (11, 0)
    kept = _kept(tmp_path, suffix)
    assert kept
    for path in kept:
        path.write_bytes(content)
    assert run(tmp_path, value=10) == (11, 0)
    assert run(tmp_path, value=10) == (11, 1)


def test_a_cache_that_cannot_be_written_is_said_once_and_harms_nothing(tmp_path, caplog):
    class Full:
        _cache_path = str(tmp_path)

        def load(self, _key):
            return None

        def save(self, _key, _data):
            raise OSError(28, "No space left on device")

    kernel_cache._say_uncached.cache_clear()
    cache = Full()
    kernel_cache._tolerate_damage(cache)
    for _ in range(3):
        cache.save("key", "data")
    assert [record.getMessage() for record in caplog.records if "NUMBA_CACHE_DIR" in record.getMessage()] == [
        record.getMessage() for record in caplog.records
    ]
    assert len(caplog.records) == 1 and "No space left" in caplog.text


def test_kernels_work_where_no_folder_can_hold_their_cache(monkeypatch: pytest.MonkeyPatch, caplog) -> None:
    kernel_cache._say_uncached.cache_clear()

    def refuse_cache(**options):
        if options.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return njit(**options)

    monkeypatch.setattr(kernel_cache, "njit", refuse_cache)
    assert kernel_cache.kernel_decorator(b"")(lambda x: x + 1)(1) == 2
    assert "NUMBA_CACHE_DIR" in caplog.text
