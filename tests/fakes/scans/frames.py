"""Synthetic sweeps for tests: an edge that moves over the picture, the same pixels for the same seed and index."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import FrameFormat, Image, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.process.clocks import epoch_utc_ns, utc_now_iso
from acquire.contract.scan_data.checksums import frame_crc32

UM_PER_MICROSTEP = 3.175


def plan_of(count: int, steps_per_frame: int = 3) -> SweepPlan:
    return SweepPlan(0, (count - 1) * steps_per_frame, steps_per_frame, UM_PER_MICROSTEP)


def start_of(folder: Path, count: int, frame_format: FrameFormat | None = None, scan_uid: str = "fake-1") -> Start:
    return Start(
        path=str(folder),
        format=frame_format or FrameFormat(64, 48, 8),
        plan=plan_of(count),
        scan_uid=scan_uid,
        user_json='{"name": "fake", "purpose": "raw"}',
        start_time_utc=utc_now_iso(),
        epoch_utc_ns=epoch_utc_ns(),
    )


def pixels_of(frame_index: int, count: int, frame_format: FrameFormat, seed: int = 0) -> NDArray[Any]:
    """Frame ``frame_index`` of a sweep of ``count``: each pixel brightens at a time of its own, with noise."""
    shape, scale = frame_format.shape, 1 << (frame_format.bit_depth - 8)
    crossing = count * (0.2 + 0.6 * np.arange(frame_format.width) / frame_format.width)
    light = 20 + 180 / (1 + np.exp(-(frame_index - crossing) / 1.5))
    row = light[:, None] if len(shape) == 3 else light
    noise = np.random.Generator(np.random.Philox(key=[seed, frame_index])).normal(0, 2, shape)
    return np.clip((row + noise) * scale, 0, (1 << frame_format.bit_depth) - 1).astype(frame_format.dtype)


def image_of(frame_index: int, pixels: NDArray[Any], start: Start, **changed: Any) -> Image:
    """The header that belongs to ``pixels``; ``changed`` replaces fields."""
    position = start.plan.position_steps(frame_index) if frame_index < start.plan.count else 0
    fields: dict[str, Any] = {
        "scan_uid": start.scan_uid,
        "frame_index": frame_index,
        "trigger_id": frame_index + 100,
        "camera_frame_id": frame_index + 200,
        "position_steps": position,
        "position_um": position * UM_PER_MICROSTEP,
        "exposure_start_ns": 1_000_000 * (frame_index + 1),
        "shape": list(pixels.shape),
        "dtype": start.format.dtype,
        "bit_depth": start.format.bit_depth,
        "pixel_format": start.format.pixel_format,
        "crc32": frame_crc32(pixels),
    }
    return Image(**{**fields, **changed})
