"""Turns a request for a scan into a plan and a `start` message; everything that can be checked is checked before."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
import uuid
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import msgspec

from acquire.cameras.protocol import CameraSettings
from acquire.contract.calibration import check_size, check_validity, load_calibration, parse_calibration
from acquire.contract.config.load import LoadedConfig, home_resolved
from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CalibrationError, CommandRefusedError
from acquire.contract.messaging.messages import FrameFormat, Start
from acquire.contract.plan import MAX_FRAMES, SweepPlan
from acquire.contract.process.clocks import epoch_utc_ns, utc_now_iso, utc_stamp
from acquire.contract.process.run_dir import FileLock
from acquire.contract.scan_data.dataset_names import CHECK_ROLES, OWNER_LOCK_NAME
from acquire.contract.units import format_bytes, format_duration, ns_from_ms
from acquire.rigs.base import Rig
from acquire.sweep.credit_window import slots_for
from acquire.sweep.settings import SweepSettings

from .requests import ScanRequest

_LONGEST_FINAL_MOVE_MS = 10_000.0
LONGEST_EXPOSURE_SHARE = 0.9
"""Of a frame's period: the rest belongs to the camera's dead time."""


@dataclass(frozen=True)
class PreparedScan:
    """A scan that may begin."""

    start: Start
    settings: SweepSettings
    slots: int
    folder: Path
    lock: FileLock
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class CheckedScan:
    """A scan that could begin, and what it would take."""

    plan: SweepPlan
    slots: int
    calibration: str
    """The calibration's JSON; empty where none is needed."""
    warnings: tuple[str, ...]
    needed_bytes: int
    free_bytes: int


def plan_of(request: ScanRequest, config: LoadedConfig, camera: CameraSettings) -> SweepPlan:
    """The plan: what the request leaves out comes from the configuration.

    Raises:
        CommandRefusedError: outside the stage's travel, or too many frames.
    """
    sweep, stage = config.rig.sweep, config.rig.stage
    plan = SweepPlan(
        first_steps=sweep.first_steps if request.first_steps is None else request.first_steps,
        last_steps=sweep.last_steps if request.last_steps is None else request.last_steps,
        steps_per_frame=request.steps_per_frame or sweep.steps_per_frame,
        um_per_microstep=stage.um_per_microstep,
        mode=request.mode or sweep.mode,
        settle_ms=stage.settle_ms if request.settle_ms is None else request.settle_ms,
        exposure_ms=camera.exposure_ms,
    )
    check_travel(plan, stage)
    longest_ms = LONGEST_EXPOSURE_SHARE * 1000 / sweep.max_rate_hz
    if plan.mode == "fly" and plan.exposure_ms > longest_ms:
        raise CommandRefusedError(
            f"an exposure of {plan.exposure_ms:g} ms is longer than {LONGEST_EXPOSURE_SHARE:g} of a frame's period "
            f"({longest_ms:.3g} ms): shorten it, lower sweep.max_rate_hz, or sweep in step mode"
        )
    if plan.count > MAX_FRAMES:
        raise CommandRefusedError(f"{plan.count} frames are more than the bound of {MAX_FRAMES}: use larger steps")
    return plan


def check_travel(plan: SweepPlan, stage: StageConfig) -> None:
    """Check that the stage reaches both ends of the plan.

    Raises:
        CommandRefusedError: it does not.
    """
    low, high = stage.travel_min_steps, stage.travel_max_steps
    for what, position in (("first", plan.first_steps), ("last", plan.last_steps)):
        if not low <= position <= high:
            raise CommandRefusedError(f"the {what} position {position} is outside the stage's travel {low}..{high}")


def estimated_duration_s(plan: SweepPlan, config: LoadedConfig) -> float:
    """Shortest duration of a sweep, in s."""
    rig = config.rig
    step_ms = 2000 * math.sqrt(plan.steps_per_frame / rig.stage.acceleration_steps_per_s2)
    frame_ms = max(1000 / rig.sweep.max_rate_hz, plan.exposure_ms + plan.settle_ms + step_ms)
    return plan.count * frame_ms / 1000 * rig.simulation.time_scale


def prepare_scan(request: ScanRequest, config: LoadedConfig, rig: Rig) -> PreparedScan:
    """Check the request and make the folder of the scan.

    Raises:
        CommandRefusedError: travel, memory, disk space, or a folder that cannot be made; says what to do.
        CalibrationError: the calibration cannot be used (F21).
    """
    found = check_scan(request, config, rig)
    folder, lock = _make_folder(config.data_dir, request.name)
    start = _start_message(request, config, rig, found, folder)
    return PreparedScan(start, sweep_settings(config, start), found.slots, folder, lock, found.warnings)


def check_scan(request: ScanRequest, config: LoadedConfig, rig: Rig) -> CheckedScan:
    """Check the request; nothing is made.

    Raises:
        CommandRefusedError: travel, memory or disk space; says what to do.
        CalibrationError: the calibration cannot be used (F21).
    """
    plan, frame_format = plan_of(request, config, rig.camera_settings), rig.camera_info.format
    slots = window_slots(config, frame_format)
    calibration, warnings = _calibration(request, config, rig, plan)
    needed, free = space_for(config, plan, frame_format)
    if free < needed:
        raise CommandRefusedError(
            f"the scan needs {format_bytes(needed)} and {config.data_dir} has {format_bytes(free)} free "
            f"({plan.count} frames, {format_duration(estimated_duration_s(plan, config))}): "
            "make room, or set storage.data_dir to another disk"
        )
    return CheckedScan(plan, slots, calibration, tuple(warnings), needed, free)


def window_slots(config: LoadedConfig, frame_format: FrameFormat) -> int:
    """Frames that may be triggered and not yet committed.

    Raises:
        CommandRefusedError: not even two fit into the bound.
    """
    bound = config.rig.limits.window_bytes
    slots = slots_for(bound, frame_format.nbytes)
    if not slots:
        raise CommandRefusedError(
            f"two frames of {format_bytes(frame_format.nbytes)} do not fit into limits.window_bytes = "
            f"{format_bytes(bound)}: raise it in rig.toml"
        )
    return slots


def _calibration(request: ScanRequest, config: LoadedConfig, rig: Rig, plan: SweepPlan) -> tuple[str, list[str]]:
    """The calibration's JSON, empty where none is needed, and warnings about it."""
    named = config.rig.reconstruct.calibration
    if named:
        calibration, text = load_calibration(home_resolved(named, "reconstruct.calibration"))
    else:
        text = rig.own_calibration(plan)
        if not text:
            if request.purpose == "object":
                raise CalibrationError(
                    "no calibration: an object needs a light plane; set reconstruct.calibration, "
                    "or scan for the maps alone with purpose 'raw'"
                )
            return "", []
        calibration = parse_calibration(text, "the rig's own calibration")
    frame_format = rig.camera_info.format
    check_size(calibration, frame_format.width, frame_format.height)
    warnings = check_validity(calibration, plan, rig.stage.status().zero_id, utc_now_iso())
    if calibration.light_plane is None and request.purpose == "object":
        raise CalibrationError(f"{named or 'the calibration'} has no light_plane: an object needs one, calibrate it")
    return text, warnings


def space_for(config: LoadedConfig, plan: SweepPlan, frame_format: FrameFormat) -> tuple[int, int]:
    """Bytes that the scan needs on its disk, and bytes that are free there."""
    place = config.data_dir
    while not place.exists() and place != place.parent:
        place = place.parent
    return (plan.count + len(CHECK_ROLES)) * frame_format.nbytes, shutil.disk_usage(place).free


def _make_folder(data_dir: Path, name: str) -> tuple[Path, FileLock]:
    stem = f"{utc_stamp()}-{re.sub(r'[^A-Za-z0-9._-]+', '-', name).strip('-.') or 'scan'}"
    folder = data_dir / stem
    try:
        data_dir.mkdir(parents=True, exist_ok=True)
        attempt = 1
        while folder.exists():
            attempt += 1
            folder = data_dir / f"{stem}-{attempt}"
        folder.mkdir()
    except OSError as error:
        raise CommandRefusedError(
            f"cannot make a folder in {data_dir}: {error.strerror}; nothing has moved; "
            "correct its permissions or set storage.data_dir"
        ) from None
    return folder.resolve(), FileLock(folder / OWNER_LOCK_NAME, "a scan in this folder")


def _start_message(request: ScanRequest, config: LoadedConfig, rig: Rig, found: CheckedScan, folder: Path) -> Start:
    zero_id = rig.stage.status().zero_id
    user = {
        "name": request.name,
        "specimen": request.specimen,
        "operator": request.operator or os.environ.get("USER", ""),
        "notes": request.notes,
        "tags": request.tags,
        "purpose": request.purpose,
    }
    return Start(
        scan_uid=uuid.uuid4().hex,
        path=str(folder),
        format=rig.camera_info.format,
        plan=found.plan,
        config_toml=config.toml(),
        calibration_json=found.calibration,
        user_json=json.dumps(user),
        start_time_utc=utc_now_iso(),
        epoch_utc_ns=epoch_utc_ns(),
        versions_json=msgspec.json.encode({"sweepscope": version("sweepscope"), "zero_id": zero_id}).decode(),
    )


def sweep_settings(config: LoadedConfig, start: Start) -> SweepSettings:
    """Settings of the sweep of ``start`` from the present configuration."""
    rig, plan = config.rig, start.plan
    travel_ms = 1000 * abs(rig.stage.travel_max_steps - rig.stage.travel_min_steps) / rig.stage.max_rate_steps_per_s
    period_ms = 1000 / rig.sweep.max_rate_hz
    return SweepSettings(
        scan_uid=start.scan_uid,
        plan=plan,
        format=start.format,
        run_up_steps=rig.stage.run_up_steps,
        period_ms=period_ms,
        frame_timeout_ns=ns_from_ms(rig.camera.frame_timeout_ms),
        max_attempts=rig.camera.max_attempts,
        camera_away_ns=ns_from_ms(rig.camera.away_s * 1000),
        writer_start_ns=ns_from_ms(rig.limits.writer_start_s * 1000),
        seal_ns=ns_from_ms(rig.limits.seal_s * 1000),
        motion_ns=ns_from_ms(2 * travel_ms + period_ms + plan.settle_ms + _LONGEST_FINAL_MOVE_MS),
        warm_up_ns=ns_from_ms(rig.lamp.warm_up_s * 1000),
        dark_frames=rig.sweep.dark_frames,
        repeat_first=rig.sweep.repeat_first,
        check_limit=rig.sweep.check_limit,
        needs_confirmation=rig.stage.kind == "uno",
        time_scale=rig.time_scale,
    )
