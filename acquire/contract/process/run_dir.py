"""The run directory: sockets and locks of the services."""

from __future__ import annotations

import errno
import fcntl
import os
import socket
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import IO

from acquire.contract.errors import AlreadyRunningError, ConfigError, NoServiceError

LANES = ("frames", "live", "results", "status", "command", "preview")
SYSTEM_RUN = Path("/run/sweepscope")
RUN_VARIABLE = "SWEEPSCOPE_RUN"
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
        ConfigError: none of them does, and one is no place for sockets.
    """
    if environ.get("SWEEPSCOPE_RUN"):
        candidates = [Path(environ["SWEEPSCOPE_RUN"])]
    else:
        xdg = environ.get("XDG_RUNTIME_DIR")
        candidates = ([Path(xdg) / "sweepscope"] if xdg else []) + [SYSTEM_RUN]
    refused: list[ConfigError] = []
    for candidate in candidates:
        try:
            if is_served(candidate):
                return candidate
        except ConfigError as error:
            refused.append(error)
    if refused:
        raise refused[0]
    places = " or ".join(str(candidate) for candidate in candidates)
    raise NoServiceError(f"no rig daemon answers in {places}: start one with 'sweepscope up' or set SWEEPSCOPE_RUN")


def is_served(run_dir: Path, lane: str = "command") -> bool:
    """True if a living process has bound the lane's socket; a file that a dead one left behind does not count.

    Raises:
        ConfigError: as :func:`socket_path`.
    """
    path = socket_path(run_dir, lane)
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True


def prepare_run_dir(path: Path) -> Path:
    """Create the run directory with mode 0700 if it is not there.

    Raises:
        ConfigError: it cannot be created, others can write to it, or its name is too long for sockets.
    """
    socket_path(path, max(LANES, key=len))
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        mode = path.stat().st_mode
    except OSError as error:
        raise ConfigError(f"cannot create the socket directory {path}: {error.strerror}; set SWEEPSCOPE_RUN") from None
    if mode & 0o007:
        raise ConfigError(f"the socket directory {path} is open to all users: chmod 0700 {path}, or set SWEEPSCOPE_RUN")
    return path


def temporary_run_dir() -> Path:
    """A new run directory among the temporary files, for a rig of this process alone.

    Raises:
        ConfigError: none can be created, or the name of ``$TMPDIR`` is too long for sockets.
    """
    try:
        path = Path(tempfile.mkdtemp(prefix="sweepscope-"))
    except OSError as error:
        raise ConfigError(f"no temporary directory can be created: {error.strerror}; set TMPDIR to another") from None
    try:
        return prepare_run_dir(path)
    except ConfigError as error:
        path.rmdir()
        raise ConfigError(str(error).replace(RUN_VARIABLE, "TMPDIR")) from None


def socket_path(run_dir: Path, lane: str) -> Path:
    """Where the socket of a lane is.

    Raises:
        ConfigError: the path is too long for a Unix socket, or not UTF-8.
    """
    path = run_dir / f"{lane}.sock"
    length = len(os.fsencode(path))
    if length > MAX_SOCKET_PATH_BYTES:
        bound = MAX_SOCKET_PATH_BYTES - (length - len(os.fsencode(run_dir)))
        raise ConfigError(
            f"the socket path {path} has {length} bytes, longer than the {MAX_SOCKET_PATH_BYTES} of a Unix socket: set "
            f"{RUN_VARIABLE} to a directory of at most {bound} bytes"
        )
    if os.fsencode(path) != str(path).encode(errors="replace"):
        raise ConfigError(f"the socket path {path} is not UTF-8 in this locale: set {RUN_VARIABLE} to another")
    return path


def endpoint(run_dir: Path, lane: str) -> str:
    """The ipc endpoint of a lane (raises ConfigError as :func:`socket_path`)."""
    return f"ipc://{socket_path(run_dir, lane)}"


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
