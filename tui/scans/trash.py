"""Moves a scan to the trash folder next to the scans, by one rename; another rename undoes it.

The trash of the desktop (send2trash) would not do: the services' user has none, and scans must stay on their own disk.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.dataset_names import TRASH_NAME
from tui.scans.folder import held


def trash_scan(folder: Path, data_dir: Path) -> Path:
    """Move a scan of ``data_dir`` to its trash folder; returns where it is now.

    Raises:
        ScanFileError: it is not a scan of that folder, or cannot be moved.
        AlreadyRunningError: another process holds its lock.
    """
    if folder.parent != data_dir.resolve():
        raise ScanFileError(f"{folder} is not in the folder of scans {data_dir}: remove it by hand")
    trash = data_dir.resolve() / TRASH_NAME
    target = trash / folder.name
    if target.exists():
        target = trash / f"{folder.name}-{datetime.now(UTC).strftime('%Y%m%dT%H%M%S%fZ')}"
    with held(folder):
        try:
            trash.mkdir(exist_ok=True)
            folder.rename(target)
        except OSError as error:
            raise ScanFileError(f"{folder.name} stays where it is: {error.strerror}") from None
    return target
