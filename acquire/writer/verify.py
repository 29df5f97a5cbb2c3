"""Verifies a scan file: frames against checksums, counts, digest. Read-only; works during a scan as well."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.calibration import age_days, parse_calibration
from acquire.contract.errors import CalibrationError
from acquire.contract.frame_ranges import ranges_of
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.dataset_names import CHECK_ROLES, PARTIAL_NAME, PROGRAM_NAME, FrameStatus
from acquire.contract.scan_data.file_layout import ScanLayout
from acquire.contract.scan_data.notes import notes_of
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.scan_data.source_files import Sources, read_sources
from acquire.contract.states import SEALED_OUTCOMES, Outcome, outcome_words
from acquire.contract.units import format_bytes

Ranges = list[tuple[int, int]]
_SHOWN = 8


class VerifyReport(msgspec.Struct, frozen=True):
    """What :func:`verify` found. Ranges are [first, last] frame indices, both ends included."""

    path: str
    scan_uid: str
    outcome: str
    reason: str
    sealed: bool
    """It has its last name and its outcome will not change."""
    expected: int
    """Frames of the plan."""
    committed: int
    """Frames that are good or re-taken."""
    durable: int
    """Frames 0..durable-1 survive a power cut."""
    missing: Ranges
    """Frames that were not taken or are damaged."""
    retaken: Ranges
    damaged: Ranges
    """Frames that the file itself calls damaged."""
    wrong_crc: Ranges
    """Committed frames whose pixels do not have their checksum."""
    wrong_checks: list[str]
    """Dark, ambient or repeated frames whose pixels do not have their checksum."""
    digest: str
    """Computed from the checksums."""
    recorded_digest: str
    """Empty until the scan is sealed."""
    recorded_committed: int
    """0 until the scan is sealed."""
    problems: list[str]
    """Everything that is not as promised, in words; a missing frame of a scan that says so is no problem."""

    @property
    def ok(self) -> bool:
        """Every frame, count and digest is consistent."""
        return not self.problems

    @property
    def complete(self) -> bool:
        """Valid, sealed as complete, nothing missing."""
        return self.ok and self.sealed and self.outcome == Outcome.COMPLETE and self.committed == self.expected

    def words(self) -> list[str]:
        """Lines for people."""
        state = "sealed" if self.sealed else "partial: it can go on, or be closed"
        lines = [
            f"{self.path}",
            outcome_words(self.outcome if self.sealed else "not sealed", self.committed, self.expected),
        ]
        lines.append(f"outcome {self.outcome} ({state})" + (f": {self.reason}" if self.reason else ""))
        lines.append(f"{self.durable} frames are durable (synced to disk)")
        for what, ranges in (("missing", self.missing), ("re-taken", self.retaken), ("damaged", self.damaged)):
            if ranges:
                lines.append(f"{what}: {in_words(ranges)}")
        lines += [f"PROBLEM: {problem}" for problem in self.problems]
        lines.append(
            "all checksums fit" + (f"; digest {self.digest}" if self.sealed else "") if self.ok else "NOT SOUND"
        )
        return lines

    def as_dict(self) -> dict[str, Any]:
        """The report as plain values, with ``ok`` and ``complete``."""
        return {**msgspec.to_builtins(self), "ok": self.ok, "complete": self.complete}


class ScanInfo(msgspec.Struct, frozen=True):
    """Metadata of a scan."""

    path: str
    scan_uid: str
    start_time_utc: str
    program_version: str
    format: FrameFormat
    frames: int
    committed: int
    outcome: str
    reason: str
    sealed: bool
    axis: str
    """``position_um`` or ``frame_number``."""
    user: dict[str, Any]
    """As people edited it afterwards, else as the scan recorded it."""
    plan: dict[str, Any]
    """Empty for imported folders."""
    has_calibration: bool
    zero_id: str
    """Which homing its positions count from; empty where the rig did not say."""
    calibration_age_days: float | None
    """Of the recorded calibration when the scan began; None where either time is not known."""
    checks: list[str]
    """Which of the dark, ambient and repeated frames are there."""
    size_bytes: int
    sources: Sources | None
    """The picture files of an imported scan; None where the file keeps none."""
    measured: dict[str, float]
    """What was measured around the sweep, by name: drift_px, brightness_change, steps_lost where they are known."""

    def words(self) -> list[str]:
        """Lines for people."""
        shape = f"{self.format.width} x {self.format.height} {self.format.pixel_format}, {self.format.bit_depth} bit"
        lines = [
            f"{self.path} ({format_bytes(self.size_bytes)})",
            f"{outcome_words(self.outcome, self.committed, self.frames)}{f' ({self.reason})' if self.reason else ''}",
            f"{self.frames} frames of {shape}, along {self.axis}",
            f"begun {self.start_time_utc or 'at an unknown time'}, uid {self.scan_uid}",
            f"written by {PROGRAM_NAME} {self.program_version}",
            f"calibration: {'in the file' if self.has_calibration else 'none in the file'}{self._age()}",
            f"check frames: {', '.join(self.checks) or 'none'}",
        ]
        lines += self.sources.lines() if self.sources else []
        lines += [f"measured {name}: {value:g}" for name, value in self.measured.items()]
        lines += [f"{key}: {_plain(value)}" for key, value in self.user.items() if value]
        lines += [f"plan {key}: {value}" for key, value in self.plan.items()]
        return lines

    def _age(self) -> str:
        return "" if self.calibration_age_days is None else f", {self.calibration_age_days:.1f} days old at the time"


def verify(scan: Path, progress: Callable[[int, int], None] = lambda _done, _total: None) -> VerifyReport:
    """Read every committed frame of SCAN and compare it with its checksum, then all counts and the digest.

    A scan that is being written is judged by the frames that were committed when this began. ``progress`` is called
    with (frames done, frames to read).

    Raises:
        ScanFileError: no scan, damaged or truncated.
    """
    with ScanReader(scan) as reader:
        status = reader.status()
        usable = np.isin(status, (FrameStatus.GOOD, FrameStatus.RETAKEN))
        crc32 = reader.field("crc32")
        wrong = []
        indices = np.flatnonzero(usable).tolist()
        for done, index in enumerate(indices, 1):
            if frame_crc32(reader.frame(index)) != crc32[index]:
                wrong.append(index)
            progress(done, len(indices))
        sealed = _is_sealed(reader)
        report = VerifyReport(
            path=str(reader.layout.path),
            scan_uid=reader.layout.scan_uid,
            outcome=reader.outcome,
            reason=str(reader.scalar("reason")),
            sealed=sealed,
            expected=reader.count,
            committed=int(np.count_nonzero(usable)),
            durable=int(reader.scalar("durable_count")),
            missing=ranges_of(np.flatnonzero(~usable).tolist()),
            retaken=_ranges(status == FrameStatus.RETAKEN),
            damaged=_ranges(status == FrameStatus.DAMAGED),
            wrong_crc=ranges_of(wrong),
            wrong_checks=[role for role in CHECK_ROLES if not _check_is_sound(reader, role)],
            digest=scan_digest(np.where(usable, crc32, 0).astype(np.uint32)),
            recorded_digest=str(reader.scalar("digest")),
            recorded_committed=int(reader.scalar("frames_committed")),
            problems=[],
        )
    return msgspec.structs.replace(report, problems=_problems(report))


def _problems(report: VerifyReport) -> list[str]:
    problems = []
    if report.wrong_crc:
        problems.append(f"frames whose pixels are not what was recorded: {in_words(report.wrong_crc)}")
    if report.wrong_checks:
        problems.append(f"check frames whose pixels are not what was recorded: {', '.join(report.wrong_checks)}")
    if report.sealed and report.recorded_digest != report.digest:
        problems.append(f"the recorded digest {report.recorded_digest or '(none)'} is not that of the frames")
    if report.sealed and report.recorded_committed != report.committed:
        problems.append(f"{report.recorded_committed} frames were recorded at the end, {report.committed} are there")
    if report.sealed and report.outcome == Outcome.COMPLETE and report.missing:
        problems.append(f"it calls itself complete, and lacks {in_words(report.missing)}")
    return problems


def info(scan: Path) -> ScanInfo:
    """Metadata of SCAN, without reading its pixels.

    Raises:
        ScanFileError: no scan, damaged or truncated.
    """
    with ScanReader(scan) as reader:
        layout = reader.layout
        return ScanInfo(
            path=str(layout.path),
            scan_uid=layout.scan_uid,
            start_time_utc=layout.start_time,
            program_version=layout.program_version,
            format=layout.format,
            frames=reader.count,
            committed=int(np.count_nonzero(reader.present())),
            outcome=reader.outcome,
            reason=str(reader.scalar("reason")),
            sealed=_is_sealed(reader),
            axis=layout.axis,
            user=_user(layout),
            plan={} if layout.plan is None else msgspec.to_builtins(layout.plan),
            has_calibration=bool(layout.verbatim["calibration"].strip()),
            zero_id=layout.zero_id,
            calibration_age_days=_calibration_age(layout),
            checks=[role for role in CHECK_ROLES if reader.check_frame(role) is not None],
            size_bytes=layout.path.stat().st_size,
            sources=read_sources(layout.path),
            measured=reader.measured,
        )


def _user(layout: ScanLayout) -> dict[str, Any]:
    edited = notes_of(layout.path.parent, layout.user)
    if not edited.edited_utc:
        return layout.user
    return {**layout.user, **msgspec.to_builtins(edited)}


def _calibration_age(layout: ScanLayout) -> float | None:
    text = layout.verbatim["calibration"].decode("utf-8", "replace")
    try:
        return age_days(parse_calibration(text), layout.start_time) if text.strip() else None
    except CalibrationError:
        return None


def in_words(ranges: Ranges) -> str:
    """``3 frames (4, 7-8)``, cut short where there are many."""
    count = sum(last - first + 1 for first, last in ranges)
    shown = ", ".join(str(first) if first == last else f"{first}-{last}" for first, last in ranges[:_SHOWN])
    return f"{count} frame{'' if count == 1 else 's'} ({shown}{', ...' if len(ranges) > _SHOWN else ''})"


def _ranges(mask: NDArray[np.bool_]) -> Ranges:
    return ranges_of(np.flatnonzero(mask).tolist())


def _is_sealed(reader: ScanReader) -> bool:
    # a writer that died before the last rename leaves a final outcome in a partial file
    return reader.layout.path.name != PARTIAL_NAME and reader.outcome in SEALED_OUTCOMES


def _check_is_sound(reader: ScanReader, role: str) -> bool:
    frame = reader.check_frame(role)
    return frame is None or frame_crc32(frame) == int(reader.field("checks/crc32")[CHECK_ROLES.index(role)])


def _plain(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value)
