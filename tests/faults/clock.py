"""A library that makes the wall clock of a process jump by an hour while a flag file exists; built with cc."""

from __future__ import annotations

import subprocess
from pathlib import Path

from tests.needs import need

_SOURCE = r"""
#define _GNU_SOURCE
#include <stdlib.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

int clock_gettime(clockid_t clock, struct timespec *now)
{
    long failed = syscall(SYS_clock_gettime, clock, now);
    const char *flag = getenv("SWEEPSCOPE_TEST_FLAG");
    if (!failed && clock == CLOCK_REALTIME && flag && access(flag, F_OK) == 0)
        now->tv_sec += 3600;
    return (int)failed;
}
"""


def wall_clock_library(folder: Path) -> Path:
    """Build the library for LD_PRELOAD in ``folder``."""
    need("gcc", "libc6-dev")
    source, library = folder / "clock.c", folder / "clock.so"
    folder.mkdir(parents=True, exist_ok=True)
    source.write_text(_SOURCE)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-o", str(library), str(source)], check=True)
    return library
