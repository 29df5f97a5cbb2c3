"""Freed memory of the size of frames stays with the process that asked for it."""

from __future__ import annotations

import sys

import pytest

from tests.waiting import run

_FAULTS = """
import resource, sys
from acquire.writer.malloc_tuning import keep_freed_memory
if not keep_freed_memory():
    sys.exit(77)
def burst():
    frames = [bytearray(3_000_000) for _ in range(8)]
burst(), burst()
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
burst()
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""
BURST_PAGES = 8 * 3_000_000 // 4096


def test_a_burst_of_frames_after_another_touches_no_fresh_page():
    done = run([sys.executable, "-c", _FAULTS])
    if done.returncode == 77:
        pytest.skip("only glibc can be asked to keep memory")
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < BURST_PAGES // 20
