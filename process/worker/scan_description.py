"""The description of a scan before its first frame and at its end; its settings and the memory that it needs."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError, ConfigError, ScanFileError, SweepscopeError
from acquire.contract.messaging.messages import End, FrameFormat, FrameRange, Start
from acquire.contract.scan_data.file_layout import zero_id_in
from acquire.contract.scan_data.report_file import SweepChecks
from acquire.contract.states import SEALED_OUTCOMES, Outcome
from acquire.contract.units import format_bytes
from process.edge_fit.early_estimates import EarlyEstimates
from process.fold.fold import Fold
from process.results.scan_frames import ScanFrames
from process.results.settings import ReconstructOptions, Recorded, Settings, recorded_in, settle

logger = logging.getLogger(__name__)


class ScanRefusedError(SweepscopeError):
    """A scan that this worker cannot fold; the sweep itself is not touched."""


@dataclass(frozen=True)
class ScanDescription:
    """A scan as the start message, or the file after a late start, describes it."""

    scan_uid: str
    folder: Path
    count: int
    """Frames of the plan."""
    recorded: Recorded
    reopened: bool = False
    """It was stopped and sealed before, and goes on now."""

    @classmethod
    def of_start(cls, start: Start) -> ScanDescription:
        """The scan that a start message begins."""
        zero_id = zero_id_in(start.versions_json)
        recorded = Recorded(start.format, start.plan, start.config_toml, start.calibration_json, zero_id)
        return cls(start.scan_uid, Path(start.path), start.plan.count, recorded, start.reopen)

    @classmethod
    def of_file(cls, frames: ScanFrames) -> ScanDescription:
        """The scan in a file that exists already.

        Raises:
            ScanFileError: what it recorded cannot be read.
        """
        layout = frames.layout
        return cls(layout.scan_uid, layout.path.parent, layout.count, recorded_in(layout))

    @property
    def planned_positions_um(self) -> NDArray[np.float64]:
        """Where the frames should be taken, [n]; NaN without a plan."""
        plan = self.recorded.plan
        return np.full(self.count, np.nan) if plan is None else plan.positions_um().astype(np.float64)


@dataclass(frozen=True)
class ScanEnd:
    """How a scan ended; the outcome is ``running`` before that."""

    outcome: str = Outcome.RUNNING.value
    missing: tuple[FrameRange, ...] = ()
    """Frame ranges [first, last] that were never taken, both ends included."""
    checks: SweepChecks = field(default_factory=SweepChecks)

    @classmethod
    def of_message(cls, end: End) -> ScanEnd:
        """From the end message."""
        return cls(end.outcome.value, tuple(end.missing), SweepChecks.of(end.checks))

    def never_coming(self, count: int, file_outcome: str) -> NDArray[np.bool_] | None:
        """Frames that will not be committed any more, [count]; None while the scan runs.

        They are those named missing, and all of them once the file is sealed.
        """
        if self.outcome not in SEALED_OUTCOMES:
            return None
        never = np.full(count, file_outcome in SEALED_OUTCOMES)
        for first, last in self.missing:
            never[first : last + 1] = True
        return never


def live_settings(recorded: Recorded) -> Settings:
    """The recorded settings; a calibration that cannot be used costs the cloud, never the maps."""
    try:
        return settle(recorded, ReconstructOptions())
    except CalibrationError as error:
        why = f"no cloud: {error}"
        recorded = dataclasses.replace(recorded, calibration_json="")
    except (ConfigError, ScanFileError) as error:
        why = f"no cloud, and default settings: {error}"
        recorded = Recorded(recorded.format, recorded.plan)
    logger.warning("%s", why)
    try:
        settings = settle(recorded, ReconstructOptions())
    except (ConfigError, ScanFileError):
        settings = settle(Recorded(recorded.format, recorded.plan), ReconstructOptions())
    return dataclasses.replace(settings, warnings=(why,))


def check_memory(form: FrameFormat, fold_bytes: int) -> None:
    """Refuse a scan whose fold does not fit into ``fold_bytes``.

    Raises:
        ScanRefusedError: how much it needs, and what to do.
    """
    shape = (form.height, form.width)
    needed = Fold.bytes_needed(shape, form.bit_depth) + EarlyEstimates.bytes_needed(shape)
    if needed > fold_bytes:
        raise ScanRefusedError(
            f"the live cloud needs {format_bytes(needed)} for frames of {form.width} x {form.height}, "
            f"limits.fold_bytes allows {format_bytes(fold_bytes)}: the scan itself is safe; raise the limit, "
            "or make the cloud afterwards with 'sweepscope reconstruct'"
        )
