"""A Debian root for one test: this machine's files under an overlay that is thrown away, with its own systemd as pid 1.

What is installed, which users are made and which units run in it never touches the machine: mounts, processes and host
name live in namespaces that end with the first process.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

from tests import ROOT, waiting

REPOSITORY = ROOT
PACKAGES = Path(next(path for path in sys.path if path.endswith("site-packages")))
SOURCE_INSIDE = "/srv/source"
PACKAGES_INSIDE = "/srv/packages"
DEADLINE_S = 120.0

_BOOT = r"""
set -e
R=$1 SOURCE=$2 PACKAGES=$3 PREFIX=$4
mount -t tmpfs tmpfs "$R"
mkdir "$R"/upper "$R"/work "$R"/root
mount -t overlay overlay -o lowerdir=/,upperdir="$R"/upper,workdir="$R"/work "$R"/root
cd "$R"/root
mkdir -p srv/source srv/packages
mount --bind "$SOURCE" srv/source
mount --bind "$PACKAGES" srv/packages
mount -t tmpfs -o mode=1777 tmpfs tmp
[ -e "./$PREFIX/bin" ] || { mkdir -p "./$PREFIX"; mount --bind "$PREFIX" "./$PREFIX"; }
mount -t proc proc proc
mount -t sysfs sysfs sys
mount -t tmpfs -o mode=755 tmpfs run
mount -t tmpfs -o mode=755 tmpfs dev
for n in null zero full random urandom tty ptmx; do touch dev/$n; mount --bind /dev/$n dev/$n; done
mkdir dev/shm dev/pts
mount -t tmpfs tmpfs dev/shm
ln -s /proc/self/fd dev/fd
mount -t tmpfs -o mode=755 tmpfs sys/fs/cgroup
mkdir sys/fs/cgroup/systemd
if ! mount -t cgroup -o none,name=systemd systemd sys/fs/cgroup/systemd; then
    umount sys/fs/cgroup
    mount -t cgroup2 cgroup2 sys/fs/cgroup
fi
rm -rf etc/systemd/system var/log/journal
mkdir -p etc/systemd/system run/log/journal
printf '[Unit]\nRequires=systemd-journald.service\nAfter=systemd-journald.service\n' >etc/systemd/system/bare.target
touch run/booting
export container=lxc
# not chroot: in one the kernel makes no user namespaces, and the services ask for theirs
pivot_root . mnt
umount -l /mnt
exec /lib/systemd/systemd --system --unit=bare.target --show-status=no --log-target=journal-or-kmsg
"""


class RootUnavailableError(Exception):
    """This machine does not let us make such a root."""


class ThrowawayRoot:
    """The running root; a context manager."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._log = folder.with_suffix(".log")
        self._outer: subprocess.Popen[bytes] | None = None
        self._init = 0

    def __enter__(self) -> ThrowawayRoot:
        words = ["unshare", "-m", "-C", "-i", "-u", "-p", "-f", "--kill-child", "--propagation", "private"]
        arguments = [str(self.folder), str(REPOSITORY), str(PACKAGES), sys.prefix]
        with self._log.open("wb") as log:
            self._outer = subprocess.Popen(
                [*words, "bash", "-c", _BOOT, "boot", *arguments], stdin=subprocess.DEVNULL, stdout=log, stderr=log
            )
        try:
            self.until(self._booted, "systemd comes up", 20)
        except AssertionError as error:
            self.__exit__()
            raise RootUnavailableError(str(error)) from None
        return self

    def __exit__(self, *_: object) -> None:
        assert self._outer is not None
        if self._init and psutil.pid_exists(self._init):
            os.kill(self._init, 9)  # the kernel ends everything in the namespace with its first process
        self._outer.kill()
        waiting.exit_status(self._outer)

    def _booted(self) -> bool:
        assert self._outer is not None
        if self._outer.poll() is not None:
            raise AssertionError(f"no root: {self._log.read_text(errors='replace')[-500:]}")
        children = psutil.Process(self._outer.pid).children()
        if not children or "systemd" not in children[0].name():
            return False
        self._init = children[0].pid
        return self.run("systemctl", "is-active", "systemd-journald.service", check=False).returncode == 0

    def run(
        self, *words: str, user: str = "root", check: bool = True, deadline_s: float = DEADLINE_S, **environ: str
    ) -> subprocess.CompletedProcess[str]:
        """Run a command inside, as ``user``, with a clean environment."""
        enter = ["nsenter", "-t", str(self._init), "-m", "-p", "-i", "-u", "-C", "-r", "-w"]
        clean = {"PATH": "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "LANG": "C.UTF-8"} | environ
        become = ["runuser", "-u", user, "--"] if user != "root" else []
        done = waiting.run([*enter, *become, *words], deadline_s, env=clean)
        if check and done.returncode:
            raise AssertionError(f"{' '.join(words)}: status {done.returncode}\n{done.stdout}\n{done.stderr}")
        return done

    def sweepscope_from_clone(
        self, *words: str, source: str = SOURCE_INSIDE, within: tuple[str, ...] = (), **more: Any
    ) -> subprocess.CompletedProcess[str]:
        """The command as it is run from a clone, before anything is installed.

        Args:
            words: the command's arguments.
            source: the clone.
            within: a command that runs it, as ``unshare -m`` does.
            more: for :meth:`run`.
        """
        command = (*within, sys.executable, "-m", "tui.cli", *words)
        return self.run(*command, PYTHONPATH=source, PYTHONDONTWRITEBYTECODE="1", **more)

    def path(self, inside: str) -> Path:
        """A path of the root as seen from outside."""
        return Path(f"/proc/{self._init}/root{inside}")

    def until(self, fact: Callable[[], Any], what: str, deadline_s: float = DEADLINE_S) -> Any:
        """Ask until it is true."""
        return waiting.wait_for(fact, what, deadline_s, why=lambda: self._log.read_text()[-2000:])
