"""The device drivers that rig.toml can name: a new one is listed here and built in ``acquire/rigs/build.py``.

Imports nothing heavy: the command line offers these names in its help.
"""

from __future__ import annotations

from typing import Final, Literal, get_args

StageKind = Literal["simulated", "uno", "legacy"]
CameraKind = Literal["simulated", "replay", "genicam", "uvc"]
STAGE_KINDS: Final[tuple[StageKind, ...]] = get_args(StageKind)
CAMERA_KINDS: Final[tuple[CameraKind, ...]] = get_args(CameraKind)
CAMERA_NODES: Final[dict[CameraKind, tuple[str, ...]]] = {"uvc": ("v4l/by-id/*-index0", "video*")}
"""Patterns of a driver's device nodes below /dev, stable names first; other cameras can be seen only when opened."""
