"""Prepares to resume an interrupted or stopped scan.

Plan and settings come from its file; its last frame is taken again and compared.
"""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from acquire.cameras.protocol import CameraSettings
from acquire.contract.calibration import parse_calibration
from acquire.contract.config.load import LoadedConfig
from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError, SweepscopeError
from acquire.contract.messaging.messages import FrameFormat, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.process.run_dir import FileLock, is_locked
from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME, PARTIAL_NAME, SEALED_NAME
from acquire.contract.scan_data.file_layout import ScanLayout
from acquire.contract.scan_data.reader import ScanReader, read_marks
from acquire.contract.states import Outcome
from acquire.contract.units import UM_PER_MM
from acquire.sweep.settings import OverlapLimits, ResumeFrom

from .scan_setup import PreparedScan, check_travel, sweep_settings, window_slots

SPECIMEN_LIMIT_UM = 2.5
"""Displacement of the specimen from which on the scan cannot go on; in pixels where the calibration has a scale."""


@dataclass(frozen=True)
class UnfinishedScan:
    """A sweep that was interrupted and can be resumed."""

    scan_uid: str
    folder: Path
    plan: SweepPlan
    committed: int


def unfinished_scan(data_dir: Path) -> UnfinishedScan | None:
    """The newest scan in ``data_dir``, if its sweep was interrupted after a frame and no process works on it."""
    try:
        files = [path for pattern in (PARTIAL_NAME, SEALED_NAME) for path in data_dir.glob(f"*/{pattern}")]
        newest = max(files, key=lambda path: path.stat().st_mtime_ns, default=None)
        if newest is None or newest.name != PARTIAL_NAME or is_locked(newest.parent / OWNER_LOCK_NAME):
            return None
        with ScanReader(newest) as reader:
            committed, layout = int(reader.present().sum()), reader.layout
    except (SweepscopeError, OSError):
        return None  # 'sweepscope scans' says what is wrong with it
    return UnfinishedScan(layout.scan_uid, newest.parent, layout.plan, committed) if layout.plan and committed else None


def prepare_resume(scan: Path, config: LoadedConfig, frame_format: FrameFormat) -> tuple[PreparedScan, CameraSettings]:
    """The scan to go on with, and the camera settings that it was begun with.

    Raises:
        ScanFileError: no scan, or damaged.
        CommandRefusedError: sealed already, nothing committed, or camera or stage are set differently.
        AlreadyRunningError: another process holds the scan.
    """
    with ScanReader(scan) as reader:
        layout = reader.layout
        _refuse_if_ended(reader)
        plan = _plan_to_go_on_with(layout, frame_format)
        _check_stage(plan, config.rig.stage)
        lock = FileLock(layout.path.parent / OWNER_LOCK_NAME, "this scan")
        with released_on_failure(lock):
            start = _start_again(layout, plan)
            settings = replace(sweep_settings(config, start), resume=_resume_from(reader))
            slots = window_slots(config, frame_format)
            camera = _camera_settings(layout, plan, config)
    return PreparedScan(start, settings, slots, layout.path.parent, lock, ()), camera


@contextmanager
def released_on_failure(lock: FileLock) -> Iterator[None]:
    """Release the lock where resuming fails: else the scan would be in use as long as this process lives."""
    try:
        yield
    except BaseException:
        lock.release()
        raise


def _check_stage(plan: SweepPlan, stage: StageConfig) -> None:
    if plan.um_per_microstep != stage.um_per_microstep:
        raise CommandRefusedError(
            f"the scan was taken with {plan.um_per_microstep:g} um per microstep, the stage is set to "
            f"{stage.um_per_microstep:g}: set stage.um_per_microstep as it was"
        )
    check_travel(plan, stage)


def _refuse_if_ended(reader: ScanReader) -> None:
    """What the operator stopped can go on; another end says that nothing is missing, or that it must not."""
    if reader.layout.path.name != PARTIAL_NAME and reader.outcome != Outcome.STOPPED:
        raise CommandRefusedError(
            f"{reader.layout.path} is closed for good ({reader.outcome}): only an interrupted or stopped scan can go on"
        )


def _plan_to_go_on_with(layout: ScanLayout, frame_format: FrameFormat) -> SweepPlan:
    if layout.plan is None:
        raise CommandRefusedError(f"{layout.path} has no plan: it did not come from a sweep")
    if layout.format != frame_format:
        raise CommandRefusedError(
            f"the scan has {layout.format.width} x {layout.format.height} {layout.format.pixel_format} of "
            f"{layout.format.bit_depth} bit, the camera {frame_format.width} x {frame_format.height} "
            f"{frame_format.pixel_format} of {frame_format.bit_depth} bit: set the camera as it was"
        )
    return layout.plan


def _resume_from(reader: ScanReader) -> ResumeFrom:
    last = _frame_to_compare(reader)
    if last < 0:
        raise CommandRefusedError(f"{reader.layout.path} holds no frame yet: start a new scan")
    before = reader.frame(last - 1) if last > 0 and reader.present()[last - 1] else None
    marks = read_marks(reader.layout.path.parent)
    return ResumeFrom(last, reader.frame(last), before, reader.frame(0), _limits(reader.layout), marks)


def _frame_to_compare(reader: ScanReader) -> int:
    """The last committed frame with a neighbour before it, without which a shift of the stage cannot be measured."""
    present = reader.present()[: reader.committed_through() + 1]
    neighboured = np.flatnonzero(present[1:] & present[:-1]) + 1
    alone = np.flatnonzero(present)
    return int(neighboured[-1] if neighboured.size else alone[-1] if alone.size else -1)


def _limits(layout: ScanLayout) -> OverlapLimits:
    text = layout.verbatim["calibration"].decode()
    if not text:
        return OverlapLimits()
    camera = parse_calibration(text, f"the calibration in {layout.path}").camera
    um_per_px = abs(camera.T[2]) / camera.K[0][0] * UM_PER_MM
    return OverlapLimits(specimen_px=SPECIMEN_LIMIT_UM / um_per_px)


def _start_again(layout: ScanLayout, plan: SweepPlan) -> Start:
    return Start(
        scan_uid=layout.scan_uid,
        path=str(layout.path.parent.resolve()),
        format=layout.format,
        plan=plan,
        config_toml=layout.verbatim["config"].decode(),
        calibration_json=layout.verbatim["calibration"].decode(),
        user_json=json.dumps(layout.user),
        start_time_utc=layout.start_time,
        epoch_utc_ns=layout.epoch_utc_ns,
        reopen=layout.path.name != PARTIAL_NAME,
    )


def _camera_settings(layout: ScanLayout, plan: SweepPlan, config: LoadedConfig) -> CameraSettings:
    recorded: dict[str, Any] = tomllib.loads(layout.verbatim["config"].decode()).get("camera", {})
    camera = config.rig.camera
    return CameraSettings(
        exposure_ms=plan.exposure_ms,
        gain=float(recorded.get("gain", camera.gain)),
        brightness_percent=float(recorded.get("brightness_percent", camera.brightness_percent)),
    )
