"""A disk of 40 MB that only the services of one run see: a tmpfs in a mount namespace of its own."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .harness import Rig

DISK_BYTES = 40_000_000


def why_not() -> str:
    """Why there can be no private mount here; empty where there can."""
    if not shutil.which("unshare") or not shutil.which("nsenter"):
        return "unshare and nsenter are not installed"
    command = ["unshare", "--mount", "mount", "-t", "tmpfs", "none", "/mnt"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.stderr.strip() if done.returncode else ""


class SmallDisk:
    """The disk, seen from outside through the process that keeps it mounted."""

    def __init__(self, keeper: subprocess.Popen[bytes], folder: Path) -> None:
        self._root, self._folder = Path(f"/proc/{keeper.pid}/root"), folder

    def outside(self, path: Path | str) -> Path:
        """What the services call ``path``."""
        return self._root / str(path).lstrip("/")

    def fill(self, leave_bytes: int) -> None:
        """Let something else take the space, all but ``leave_bytes``."""
        hog = self.outside(self._folder) / "hog"
        free = shutil.disk_usage(hog.parent).free
        with hog.open("ab") as file:
            file.write(bytes(max(0, free - leave_bytes)))

    def make_room(self) -> None:
        """Give it back."""
        (self.outside(self._folder) / "hog").unlink(missing_ok=True)


@contextmanager
def small_disk(rig: Rig) -> Iterator[SmallDisk]:
    """Mount the disk at the run's data_dir; services that are started from now on live in its namespace."""
    rig.data_dir.mkdir(parents=True, exist_ok=True)
    script = f'mount -t tmpfs -o size={DISK_BYTES} none "$0" && echo ready && exec cat'
    keeper = subprocess.Popen(
        ["unshare", "--mount", "sh", "-c", script, str(rig.data_dir)],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
    )  # fmt: skip
    try:
        assert keeper.stdout is not None and keeper.stdout.readline() == b"ready\n"
        rig.prefix = ["nsenter", "--target", str(keeper.pid), "--mount"]
        yield SmallDisk(keeper, rig.data_dir)
    finally:
        rig.prefix = []
        keeper.kill()
        keeper.wait()
        for pipe in (keeper.stdin, keeper.stdout):
            if pipe is not None:
                pipe.close()
