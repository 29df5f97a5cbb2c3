"""Runs commands without a shell, and replaces files and links atomically."""

from __future__ import annotations

import subprocess
from pathlib import Path

from acquire.contract.errors import SweepscopeError
from acquire.contract.files import replace_file

LONG_S = 1800.0


class InstallError(SweepscopeError):
    """A step of the installation failed; what ran before still runs."""


def run(*command: str | Path, timeout_s: float = LONG_S) -> str:
    """Run a command; returns its stdout.

    Raises:
        InstallError: it is missing, failed, or took too long; with the last line of its output.
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
    """Make the symbolic link ``link`` point to ``target``, atomically."""
    replace_file(link, lambda temporary: temporary.symlink_to(target))


def put(path: Path, text: str) -> None:
    """Write a file that everybody may read, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    replace_file(path, text.encode(), mode=0o644)
