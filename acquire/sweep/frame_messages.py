"""Builds the messages that describe a sweep: one `image` for each frame, the `end` with all its accounts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from acquire.cameras.protocol import CameraFrame
from acquire.contract.frame_ranges import ranges_of
from acquire.contract.messaging.messages import End, FrameFormat, Image, Role
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.states import Outcome
from acquire.contract.units import steps_to_um

from .credit_window import Window
from .pairing import Shot
from .settings import SweepSettings


def image_of_shot(frame: CameraFrame, shot: Shot, settings: SweepSettings, role: Role = "sweep") -> Image:
    """The header of a frame that is paired with its trigger."""
    return Image(
        scan_uid=settings.scan_uid,
        frame_index=shot.frame_index,
        role=role,
        attempt=shot.attempt,
        trigger_id=shot.trigger_id,
        camera_frame_id=frame.camera_frame_id,
        position_steps=shot.position_steps,
        position_um=shot.position_um,
        trigger_cycles=shot.trigger_cycles,
        exposure_start_ns=frame.exposure_start_ns,
        **_pixels(frame, settings.format),
    )


def image_of_snap(frame: CameraFrame, role: Role, position_steps: int, settings: SweepSettings) -> Image:
    """The header of a dark or ambient frame."""
    return Image(
        scan_uid=settings.scan_uid,
        frame_index=0,
        role=role,
        camera_frame_id=frame.camera_frame_id,
        position_steps=position_steps,
        position_um=steps_to_um(position_steps, settings.plan.um_per_microstep),
        exposure_start_ns=frame.exposure_start_ns,
        **_pixels(frame, settings.format),
    )


def _pixels(frame: CameraFrame, frame_format: FrameFormat) -> dict[str, Any]:
    return {
        "shape": list(frame_format.shape),
        "dtype": frame_format.dtype,
        "bit_depth": frame_format.bit_depth,
        "pixel_format": frame_format.pixel_format,
        "crc32": frame_crc32(frame.pixels),
    }


def end_of_sweep(
    outcome: Outcome,
    reason: str,
    *,
    settings: SweepSettings,
    sent: int,
    window: Window,
    retaken: Iterable[int],
    counters: Mapping[str, int],
    checks: Mapping[str, float],
) -> End:
    """The account of a sweep; frames that are not committed are missing."""
    count = settings.plan.count
    crc32 = np.zeros(count, np.uint32)
    for frame_index, value in window.committed.items():
        crc32[frame_index] = value
    return End(
        scan_uid=settings.scan_uid,
        outcome=outcome,
        reason=reason,
        expected=count,
        sent=sent,
        missing=ranges_of([k for k in range(count) if k not in window.committed]),
        retaken=ranges_of(list(retaken)),
        digest=scan_digest(crc32),
        counters=dict(counters),
        checks=dict(checks),
    )
