"""Reads what the services logged from systemd's journal, and packs a support report."""

from __future__ import annotations

import io
import json
import os
import platform
import shutil
import tarfile
from collections.abc import Mapping, Sequence
from importlib.metadata import distributions
from pathlib import Path

from acquire.contract.errors import SweepscopeError
from acquire.contract.process.logs import SCAN_FIELD, SERVICE_FIELD
from tui.install.machine import InstallError, run

REPORT_LINES = 5000


class NoJournalError(SweepscopeError):
    """This machine has no journal."""


def journal_command(
    *, service: str = "", scan_uid: str = "", lines: int = 200, follow: bool = False, as_json: bool = False
) -> tuple[str, ...]:
    """The journalctl command line; systemd's own messages about our units are included.

    Raises:
        NoJournalError: no journalctl, or no journal.
    """
    found = shutil.which("journalctl")
    if found is None or not any(Path(path).is_dir() for path in ("/run/log/journal", "/var/log/journal")):
        raise NoJournalError(
            "there is no journal here; services started by 'sweepscope up' or 'demo' log to its terminal or folder"
        )
    words = [found, "--no-pager", f"--lines={lines}", f"--output={'json' if as_json else 'short-iso'}"]
    if follow:
        words.append("--follow")
    if scan_uid:
        words.append(f"{SCAN_FIELD}={scan_uid}")
    if service:
        words.append(f"{SERVICE_FIELD}={service}")
    elif not scan_uid:
        words += ["--unit=sweepscope-*"] if os.getuid() == 0 else ["--unit=sweepscope-*", "--user-unit=sweepscope-*"]
    return tuple(words)


def versions() -> dict[str, object]:
    """Versions of Python, packages and system."""
    packages = {dist.metadata["Name"]: dist.version for dist in distributions() if dist.metadata["Name"]}
    return {
        "python": platform.python_version(),
        "system": platform.platform(),
        "cpus": os.cpu_count(),
        "packages": dict(sorted(packages.items())),
    }


def last_logs() -> str:
    """The newest lines of all services, or the reason why there are none."""
    try:
        return run(*journal_command(lines=REPORT_LINES), timeout_s=60)
    except (NoJournalError, InstallError) as error:
        return f"{error}\n"


def pack(target: Path, texts: Mapping[str, str]) -> None:
    """Write a .tar.gz that only its owner can read; an existing file is not replaced.

    Raises:
        SweepscopeError: the file exists already, or cannot be written.
    """
    try:
        descriptor = os.open(target, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise SweepscopeError(f"cannot write {target}: {error.strerror}; name another file") from None
    with os.fdopen(descriptor, "wb") as file, tarfile.open(fileobj=file, mode="w:gz") as archive:
        for name, text in texts.items():
            data = text.encode()
            entry = tarfile.TarInfo(f"sweepscope-report/{name}")
            entry.size = len(data)
            archive.addfile(entry, io.BytesIO(data))


def without_home(text: str, homes: Sequence[str]) -> str:
    """The text with home folders replaced by ~: they contain people's names."""
    for home in homes:
        if len(home) > 1:
            text = text.replace(home, "~")
    return text


def as_text(value: object) -> str:
    """Indented JSON."""
    return json.dumps(value, indent=1, default=str) + "\n"
