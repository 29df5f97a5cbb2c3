"""Where the results of a scan are, and how one of them is replaced."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from acquire.contract.errors import SweepscopeError
from acquire.contract.files import replace_file
from acquire.contract.scan_data.dataset_names import CLOUD_NAME, MAPS_NAME, REPORT_NAME


class ResultWriteError(SweepscopeError):
    """A result could not be written; what was there before is untouched."""


@dataclass(frozen=True)
class ResultPaths:
    """The files of a scan's results."""

    folder: Path

    @property
    def maps(self) -> Path:
        """maps.h5."""
        return self.folder / MAPS_NAME

    @property
    def cloud(self) -> Path:
        """cloud.ply."""
        return self.folder / CLOUD_NAME

    @property
    def report(self) -> Path:
        """report.json."""
        return self.folder / REPORT_NAME


def write_result(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Replace a result; it is not synced to disk, because it can be made again from the scan.

    Raises:
        ResultWriteError: the folder is missing, full or not writable.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        why = error.strerror or str(error).splitlines()[0]
        raise ResultWriteError(
            f"cannot write {path}: {why}; the scan is safe, make room or choose another folder with --out"
        ) from None
