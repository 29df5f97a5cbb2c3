"""The machine as the installer sees it: runs commands without a shell, moves links at once, knows if systemd runs."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from acquire.contract.errors import SweepscopeError
from acquire.contract.files import replace_file

LONG_S = 1800.0


class InstallError(SweepscopeError):
    """A step of installing that failed; what ran before still runs."""


def run(*command: str | Path, timeout_s: float = LONG_S) -> str:
    """Run a command; returns what it said.

    Raises:
        InstallError: it is missing, failed, or took too long; with its last line.
    """
    words = [str(word) for word in command]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=timeout_s, check=True)
    except subprocess.CalledProcessError as error:
        said = (error.stderr or error.stdout or "").strip().splitlines()
        raise InstallError(f"'{' '.join(words)}' failed: {said[-1] if said else error.returncode}") from None
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InstallError(f"'{' '.join(words)}' failed: {error}") from None
    return done.stdout


def point(link: Path, target: Path) -> None:
    """Let the symbolic link ``link`` point to ``target``; it exists at every moment."""
    replace_file(link, lambda temporary: temporary.symlink_to(target))


def put(path: Path, text: str, mode: int = 0o644) -> None:
    """Write a file in one step."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode(), mode=mode)


def systemd_runs(*, user: bool) -> bool:
    """True if there is a systemd that can be asked to start things."""
    if not Path("/run/systemd/system").is_dir():
        return False
    return not user or bool(os.environ.get("XDG_RUNTIME_DIR"))


def systemctl(*words: str, user: bool, timeout_s: float = 300.0) -> str:
    """Ask systemd (raises InstallError)."""
    return run("systemctl", *(("--user",) if user else ()), *words, timeout_s=timeout_s)
