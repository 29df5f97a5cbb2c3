"""Lists the scans of a folder with outcome, size, points, age and notes; an unreadable one with the reason."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from acquire.contract.errors import ScanFileError, SweepscopeError
from acquire.contract.process.run_dir import FileLock, is_locked
from acquire.contract.scan_data.dataset_names import CLOUD_NAME, MAPS_NAME, OWNER_LOCK_NAME, PARTIAL_NAME, SEALED_NAME
from acquire.contract.scan_data.notes import Notes, notes_of
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.scan_data.report_file import find_report
from acquire.contract.states import SEALED_OUTCOMES, Outcome, outcome_words
from acquire.contract.units import format_bytes
from tui.scans.copies import Copied, copies_of

ScanState = Literal["running", "sealed", "interrupted", "unreadable"]
SECONDS_PER_DAY = 86_400


@dataclass(frozen=True)
class ScanEntry:
    """One scan of the folder."""

    folder: Path
    state: ScanState
    """``running``: its lock is held now; ``interrupted``: it is not held, and the scan can be resumed."""
    outcome: str = ""
    reason: str = ""
    committed: int = 0
    expected: int = 0
    size_bytes: int = 0
    """All files of the folder."""
    points: int | None = None
    """None: there is no cloud."""
    saturated_share: float | None = None
    """Share of saturated pixels among those over the contrast; None without a report."""
    has_maps: bool = False
    started_utc: str = ""
    """ISO 8601 with Z; empty if not known."""
    purpose: str = ""
    calibrated: bool = False
    """The scan has a calibrated light plane."""
    calibration_days: float | None = None
    """Age of the calibration when the scan was taken; None if its date is not known."""
    size_px: tuple[int, int] = (0, 0)
    """Width and height."""
    notes: Notes = field(default_factory=Notes)
    copies: tuple[Copied, ...] = ()
    problem: str = ""
    """Why it cannot be read."""

    @property
    def outcome_words(self) -> str:
        """``SAVED``, ``stopped 412/527``, ``running``, ``unreadable``."""
        if self.state in ("running", "unreadable"):
            return self.state
        if self.outcome == Outcome.COMPLETE and self.committed == self.expected:
            return "SAVED"
        return f"{self.outcome} {self.committed}/{self.expected}"

    @property
    def calibration_words(self) -> str:
        """``none``, ``yes`` without a date, or its age when the scan was taken."""
        if not self.calibrated:
            return "none"
        return "yes" if self.calibration_days is None else _days_words(self.calibration_days)

    def age_words(self, now: datetime) -> str:
        """``12 min``, ``3 h``, ``5 days``."""
        started = _time(self.started_utc)
        return "?" if started is None else age_words((now - started).total_seconds())

    def lines(self) -> list[str]:
        """All facts as lines of text."""
        if self.state == "unreadable":
            return [f"{self.folder.name}: {self.problem}"]
        words = outcome_words(self.outcome, self.committed, self.expected)
        points = "no cloud" if self.points is None else f"{self.points} points"
        found = [
            f"{words}{f' ({self.reason})' if self.reason else ''}" if self.state != "running" else "running now",
            f"{self.size_px[0]} x {self.size_px[1]} px, {format_bytes(self.size_bytes)}, {points}",
            f"begun {self.started_utc or 'at an unknown time'}, calibration: {self.calibration_words}",
        ]
        notes = self.notes
        found += [
            f"{label}: {text}"
            for label, text in (
                ("specimen", notes.specimen),
                ("operator", notes.operator),
                ("tags", ", ".join(notes.tags)),
                ("notes", notes.notes),
            )
            if text
        ]
        return found + [copied.words() for copied in self.copies]


def age_words(seconds: float) -> str:
    """A duration in its largest unit."""
    if seconds < 60:
        return "now"
    if seconds < 3600:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.0f} h" if seconds < 2 * SECONDS_PER_DAY else _days_words(seconds / SECONDS_PER_DAY)


def _days_words(days: float) -> str:
    return "today" if days < 1 else f"{days:.0f} day{'' if round(days) == 1 else 's'}"


class ScanFolder:
    """The folder of all scans; scans that did not change since the last look are not read again."""

    def __init__(self, data_dir: Path) -> None:
        self.data_dir = data_dir
        self._known: dict[Path, tuple[object, ScanEntry]] = {}

    def look(self) -> list[ScanEntry]:
        """All scans, the newest first."""
        entries = []
        for folder in _scan_folders(self.data_dir):
            signature = _signature(folder)
            known = self._known.get(folder)
            if known is None or known[0] != signature:
                known = (signature, read_entry(folder))
                self._known[folder] = known
            entries.append(known[1])
        self._known = {entry.folder: self._known[entry.folder] for entry in entries}
        return sorted(entries, key=lambda entry: (entry.started_utc or "", entry.folder.name), reverse=True)


def _scan_folders(data_dir: Path) -> list[Path]:
    try:
        found = [path for path in data_dir.iterdir() if path.is_dir() and not path.name.startswith(".")]
    except FileNotFoundError:
        return []  # no scan was taken yet
    except OSError as error:
        raise ScanFileError(f"cannot read the folder of scans {data_dir}: {error.strerror}") from None
    return [folder for folder in found if any((folder / name).exists() for name in (SEALED_NAME, PARTIAL_NAME))]


def _signature(folder: Path) -> object:
    """A value that changes with every file of the folder, and at every call for a running scan."""
    try:
        files = sorted((path.name, path.stat().st_mtime_ns, path.stat().st_size) for path in folder.iterdir())
    except OSError:
        return object()
    return object() if _is_owned(folder) else tuple(files)


def _is_owned(folder: Path) -> bool:
    """True while a sweep writes into this folder. A sealed scan is not tested: the test takes its lock for a moment."""
    if (folder / SEALED_NAME).exists():
        return False
    try:
        return is_locked(folder / OWNER_LOCK_NAME)
    except OSError:
        return False


def read_entry(folder: Path) -> ScanEntry:
    """Facts of one scan; the contents of a file never raise."""
    size_bytes = sum(path.stat().st_size for path in folder.iterdir() if path.is_file())
    try:
        with ScanReader(folder) as reader:
            layout, outcome = reader.layout, reader.outcome
            committed, reason = int(reader.present().sum()), str(reader.scalar("reason"))
        notes = notes_of(folder, layout.user)
        copies = copies_of(folder)
    except (SweepscopeError, OSError, ValueError) as error:
        return ScanEntry(folder, "unreadable", size_bytes=size_bytes, problem=" ".join(str(error).split()))
    state = _state(folder, layout.path, outcome)
    if state == "interrupted" and outcome == Outcome.RUNNING:
        outcome = Outcome.INTERRUPTED  # its writer died, and recover has not run yet
    report = find_report(folder)
    counts = report.counts if report is not None else {}
    calibrated, days = _calibration(layout.verbatim["calibration"], layout.start_time)
    return ScanEntry(
        folder=folder,
        state=state,
        outcome=outcome,
        reason=reason,
        committed=committed,
        expected=layout.count,
        size_bytes=size_bytes,
        points=_points(folder, counts),
        saturated_share=_share(counts, "quality_saturated", "over_contrast"),
        has_maps=(folder / MAPS_NAME).is_file(),
        started_utc=layout.start_time,
        purpose=layout.purpose,
        calibrated=calibrated,
        calibration_days=days,
        size_px=(layout.format.width, layout.format.height),
        notes=notes,
        copies=copies,
    )


def _state(folder: Path, path: Path, outcome: str) -> ScanState:
    if _is_owned(folder):
        return "running"
    return "sealed" if path.name != PARTIAL_NAME and outcome in SEALED_OUTCOMES else "interrupted"


def _points(folder: Path, counts: dict[str, int]) -> int | None:
    points = counts.get("points")
    return points if points or (folder / CLOUD_NAME).is_file() else None


def _share(counts: dict[str, int], part: str, whole: str) -> float | None:
    some, all_of_them = counts.get(part), counts.get(whole, 0)
    return some / all_of_them if some is not None and all_of_them > 0 else None


def _calibration(text: bytes, started_utc: str) -> tuple[bool, float | None]:
    """Whether there is a light plane, and its age in days when the scan was taken."""
    try:
        found = json.loads(text or b"{}")
    except (ValueError, RecursionError):
        return False, None
    if not isinstance(found, dict) or not isinstance(found.get("light_plane"), dict):
        return False, None
    valid = found.get("valid_for")
    made = _time(str(valid.get("created_utc") or "")) if isinstance(valid, dict) else None
    started = _time(started_utc)
    if made is None or started is None:
        return True, None
    return True, max(0.0, (started - made).total_seconds() / SECONDS_PER_DAY)


def _time(text: str) -> datetime | None:
    try:
        found = datetime.fromisoformat(text)
    except ValueError:
        return None
    return found if found.tzinfo else found.replace(tzinfo=UTC)


def scan_folder(scan: Path) -> Path:
    """The folder of SCAN (a folder, or the scan.h5 in it).

    Raises:
        ScanFileError: no scan, or an .h5 file whose folder is not a scan's.
    """
    folder = scan.parent if scan.is_file() else scan
    if not any((folder / name).is_file() for name in (SEALED_NAME, PARTIAL_NAME)):
        raise ScanFileError(f"{scan} is not the folder of a scan: it holds neither {SEALED_NAME} nor {PARTIAL_NAME}")
    if scan.is_file() and scan.name not in (SEALED_NAME, PARTIAL_NAME):
        raise ScanFileError(f"{scan.name} is not the file of the scan in its folder: name the folder")
    return folder.resolve()


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold the lock of a scan while inside, so that no sweep, recovery or resume touches it.

    Raises:
        AlreadyRunningError: another process holds it; nothing was changed.
        ConfigError: the folder cannot be written to.
    """
    lock = FileLock(folder / OWNER_LOCK_NAME, f"a sweep, or other work on {folder.name},")
    try:
        yield
    finally:
        lock.release()
