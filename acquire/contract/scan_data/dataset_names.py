"""The layout of scan.h5: every path, type and file name; described in docs/design.md."""

from __future__ import annotations

from enum import IntEnum
from pathlib import Path
from typing import Final

from acquire.contract.errors import ScanFileError

LAYOUT_VERSION: Final = 1
PROGRAM_NAME: Final = "sweepscope"

SEALED_NAME: Final = "scan.h5"
PARTIAL_NAME: Final = "scan.partial.h5"
CREATING_PREFIX: Final = ".creating-"
OWNER_LOCK_NAME: Final = "owner.lock"
MAPS_NAME: Final = "maps.h5"
CLOUD_NAME: Final = "cloud.ply"
REPORT_NAME: Final = "report.json"
TRUTH_NAME: Final = "truth.h5"
PINS_NAME: Final = "twin.jsonl"
"""What the pins of the emulated controller did at each trigger."""
NO_SCAN_NAMES: Final = frozenset({OWNER_LOCK_NAME, TRUTH_NAME, PINS_NAME})
"""Files that a folder may hold without a scan: they are not worth keeping."""
MARKS_NAME: Final = "marks.json"
"""Measurements of a sweep before its end, by the names of ``End.checks``; copied into scan.h5 when it is sealed."""
NOTES_NAME: Final = "notes.json"
"""Notes written about the scan afterwards."""
COPIES_NAME: Final = "copies.json"
"""Where the scan was copied to, each copy verified."""
CHECKSUMS_NAME: Final = "SHA256SUMS"
"""In a copy: the checksums that it was verified with, for ``sha256sum -c``."""
TRASH_NAME: Final = ".trash"
"""Folder in the folder of scans where removed scans wait."""

DATA: Final = "/entry/data/data"
FRAME_FIELDS: Final[dict[str, str]] = {
    "position_um": "<f8",
    "position_steps": "<i8",
    "trigger_id": "<i8",
    "camera_frame_id": "<i8",
    "exposure_start_ns": "<i8",
    "attempt": "|u1",
    "crc32": "<u4",
    "status": "|u1",
}
"""Per-frame datasets under /entry/data, shape [n]; ``status`` is written last: the commit record."""

OUTCOME_BYTES: Final = 16
REASON_BYTES: Final = 512
DIGEST_BYTES: Final = 64
MEASURED_BYTES: Final = 2048
SCALARS: Final[dict[str, str]] = {
    "outcome": f"|S{OUTCOME_BYTES}",
    "reason": f"|S{REASON_BYTES}",
    "durable_count": "<u8",
    "frames_committed": "<u8",
    "digest": f"|S{DIGEST_BYTES}",
}
"""Scalars under /entry that change while the scan runs, made beforehand, written at their offsets."""

MEASURED: Final = "measured"
"""Optional fixed bytes under /entry: what was measured around the sweep (``End.checks``), JSON; empty until sealed."""

SOURCES: Final = "sources"
"""Optional group under /entry of imported scans: name, size_bytes, sha256 and page of each frame's file, shape [n]."""

VERBATIM: Final = ("config", "calibration", "plan", "user")
"""Fixed bytes under /entry that never change; each has an attribute ``sha256``."""

CHECK_ROLES: Final = ("dark", "ambient", "repeat", "overlap")
CHECKS_DATA: Final = "/entry/checks/data"
CHECKS_STATUS: Final = "/entry/checks/status"
CHECKS_CRC32: Final = "/entry/checks/crc32"
"""Frames beside the sweep: dark, ambient, frame 0 repeated, the last frame before an interruption taken again.

Shape [4, h, w(, 3)], status and crc32 [4]; `overlap` may be written again by each resume."""


class FrameStatus(IntEnum):
    """The commit record of one frame."""

    MISSING = 0
    GOOD = 1
    RETAKEN = 2
    DAMAGED = 3


def find_scan_file(scan: Path) -> Path:
    """The .h5 of SCAN, which is a scan's folder or the file itself.

    Raises:
        ScanFileError: there is none.
    """
    if scan.is_file():
        return scan
    if not scan.exists():
        raise ScanFileError(f"{scan} does not exist: give a scan's folder or its .h5")
    for name in (SEALED_NAME, PARTIAL_NAME):
        if (scan / name).is_file():
            return scan / name
    raise ScanFileError(
        f"{scan} holds neither {SEALED_NAME} nor {PARTIAL_NAME}: it is no scan; of a folder of pictures "
        "'sweepscope import' makes one"
    )
