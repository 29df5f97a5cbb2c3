"""Small scans in a folder of scans, made by the writer's own module: sealed, interrupted or running."""

from __future__ import annotations

import json
from contextlib import closing
from pathlib import Path

import msgspec

from acquire.contract.scan_data.dataset_names import OWNER_LOCK_NAME
from acquire.contract.states import Outcome
from acquire.writer.scan_file import create_scan
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 8

CALIBRATION = {
    "format": "sweepscope-calibration",
    "version": 1,
    "camera": {
        "width": 64,
        "height": 48,
        "K": [[100, 0, 32], [0, 100, 24], [0, 0, 1]],
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "T": [0, 0, 100],
    },
    "light_plane": {
        "kind": "translating",
        "parameter": "position_um",
        "normal": [1, 0, 0],
        "corner_origin_mm": [0, 0, 0],
        "corner_velocity_mm": [0.001, 0, 0],
    },
}
"""A whole calibration.json as its object: a camera of 64 x 48 pixels and a light plane that moves."""


def make_scan(
    folder: Path,
    frames: int = COUNT,
    *,
    count: int = COUNT,
    seal: bool = True,
    started_utc: str = "2026-01-02T03:04:05Z",
    calibration: dict | None = None,
    points: int | None = None,
    **user: object,
) -> Path:
    """A scan of ``count`` frames of which ``frames`` were taken; complete if all were, else stopped."""
    start = start_of(folder, count, scan_uid=folder.name)
    start = msgspec.structs.replace(
        start,
        start_time_utc=started_utc,
        calibration_json="" if calibration is None else json.dumps(calibration),
        user_json=json.dumps({"name": folder.name, "purpose": "raw", **user}),
    )
    with closing(create_scan(folder, start)) as scan:
        for frame_index in range(frames):
            pixels = pixels_of(frame_index, count, start.format)
            scan.write_frame(image_of(frame_index, pixels, start), pixels)
        if seal:
            scan.seal(Outcome.COMPLETE if frames == count else Outcome.STOPPED, "")
    (folder / OWNER_LOCK_NAME).touch()
    if points is not None:
        (folder / "report.json").write_text(json.dumps({"counts": {"points": points}}))
    return folder
