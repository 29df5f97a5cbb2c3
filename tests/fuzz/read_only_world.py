"""A view of this machine in which only two folders can be written to: cases run as root, with any path as a target."""

from __future__ import annotations

import ctypes
import os
import subprocess
from pathlib import Path

_CLONE_NEWNS = 0x20000


def enter_read_only_world(*writable: Path) -> None:
    """Move this process into mounts of its own, all read-only but ``writable``; call it before any thread is started.

    Raises:
        OSError: this machine lets root make no mounts of its own.
        subprocess.CalledProcessError: a mount could not be changed.
    """
    if ctypes.CDLL(None, use_errno=True).unshare(_CLONE_NEWNS):
        raise OSError(ctypes.get_errno(), "no mounts of our own: unshare")
    _mount("--make-rprivate", "/")
    for path in writable:
        _mount("--bind", str(path), str(path))
    points = [line.split()[4] for line in Path("/proc/self/mountinfo").read_text(encoding="utf-8").splitlines()]
    for point in dict.fromkeys(points):
        if Path(point) not in writable and os.access(point, os.F_OK) and not point.startswith("/proc"):
            _mount("-o", "remount,bind,ro", point)
    for name in ("/", "/dev"):
        _check(Path(name) / "sweepscope-fuzz")


def _check(probe: Path) -> None:
    try:
        probe.touch()
    except OSError:
        return
    probe.unlink()
    raise OSError(f"{probe.parent} can still be written to")


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True)
