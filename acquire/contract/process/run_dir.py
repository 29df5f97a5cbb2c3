"""The run directory: sockets and locks of the services."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from acquire.contract.errors import AlreadyRunningError, ConfigError, NoServiceError

LANES = ("frames", "live", "results", "status", "command", "preview")
SYSTEM_RUN = Path("/run/sweepscope")
MAX_SOCKET_PATH_BYTES = 107


def service_run_dir(environ: Mapping[str, str] = os.environ) -> Path:
    """The directory where services create their sockets (not created here)."""
    if environ.get("SWEEPSCOPE_RUN"):
        return Path(environ["SWEEPSCOPE_RUN"])
    if environ.get("XDG_RUNTIME_DIR"):
        return Path(environ["XDG_RUNTIME_DIR"]) / "sweepscope"
    return SYSTEM_RUN


def client_run_dir(environ: Mapping[str, str] = os.environ) -> Path:
    """The first directory that holds a live ``command.sock``; ``$SWEEPSCOPE_RUN`` set means only that one.

    Raises:
        NoServiceError: none of them does.
    """
    if environ.get("SWEEPSCOPE_RUN"):
        candidates = [Path(environ["SWEEPSCOPE_RUN"])]
    else:
        xdg = environ.get("XDG_RUNTIME_DIR")
        candidates = ([Path(xdg) / "sweepscope"] if xdg else []) + [SYSTEM_RUN]
    for candidate in candidates:
        if is_served(candidate):
            return candidate
    places = " or ".join(str(candidate) for candidate in candidates)
    raise NoServiceError(f"no rig daemon answers in {places}: start one with 'sweepscope up' or set SWEEPSCOPE_RUN")


def is_served(run_dir: Path, lane: str = "command") -> bool:
    """True if a living process has bound the lane's socket; a file that a dead one left behind does not count."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(run_dir / f"{lane}.sock"))
        except OSError:
            return False
    return True


def prepare_run_dir(path: Path) -> Path:
    """Create the run directory with mode 0700 if it is not there; refuse one that others can write to."""
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"cannot create the socket directory {path}: {error.strerror}; set SWEEPSCOPE_RUN") from None
    if mode & 0o007:
        raise ConfigError(f"the socket directory {path} is open to all users: chmod 0700 {path}, or set SWEEPSCOPE_RUN")
    return path


def endpoint(run_dir: Path, lane: str) -> str:
    """The ipc endpoint of a lane.

    Raises:
        ConfigError: the path is too long for a Unix socket.
    """
    path = run_dir / f"{lane}.sock"
    if len(os.fsencode(path)) > MAX_SOCKET_PATH_BYTES:
        raise ConfigError(
            f"the socket path {path} is longer than {MAX_SOCKET_PATH_BYTES} bytes: set SWEEPSCOPE_RUN to a shorter one"
        )
    return f"ipc://{path}"


class FileLock:
    """An exclusive flock that lives as long as this object is held; the file names the holder's pid."""

    def __init__(self, path: Path, what: str) -> None:
        """Take the lock at ``path`` at once or raise.

        Raises:
            AlreadyRunningError: another process holds it; the text names its pid.
            ConfigError: the file cannot be created.
        """
        self.path = path
        try:
            self._file: IO[str] = path.open("a+", encoding="ascii")
        except OSError as error:
            raise ConfigError(f"cannot create the lock {path}: {error.strerror}") from None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = self._holder()
            self._file.close()
            if error.errno not in (errno.EAGAIN, errno.EACCES):
                raise
            raise AlreadyRunningError(f"{what} is already running (pid {holder}); stop it first") from None
        self._file.truncate(0)
        self._file.write(f"{os.getpid()}\n")
        self._file.flush()

    def _holder(self) -> str:
        self._file.seek(0)
        return self._file.read(32).strip() or "unknown"

    def release(self) -> None:
        """Release the lock; the file stays, so that no process can lock a file that is being removed."""
        self._file.close()


def lock_service(run_dir: Path, service: str) -> FileLock:
    """Lock ``<run>/<service>.lock`` before anything is bound."""
    return FileLock(run_dir / f"{service}.lock", f"a {service}")


def is_locked(path: Path) -> bool:
    """True if a living process holds the lock at ``path``."""
    try:
        with path.open("r+", encoding="ascii") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError as error:
        if error.errno in (errno.EAGAIN, errno.EACCES):
            return True
        raise
    return False
