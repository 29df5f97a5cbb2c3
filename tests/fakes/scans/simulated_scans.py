"""Sealed scans of the simulated rig without any service: rendered, written, with their truth beside them."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import numpy as np

from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.messaging.messages import FrameFormat, Image
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.simulation import Renderer, build_scene, truth, write_truth
from acquire.writer.create_file import ScanRecipe
from acquire.writer.scan_file import _create_in

UM_PER_MICROSTEP = 3.175


def plan_of(first: int = 0, last: int = 1578, steps: int = 3) -> SweepPlan:
    return SweepPlan(first_steps=first, last_steps=last, steps_per_frame=steps, um_per_microstep=UM_PER_MICROSTEP)


def simulate_sweep(
    folder: Path,
    config: SimulationConfig,
    *,
    size: tuple[int, int] = (512, 384),
    plan: SweepPlan | None = None,
    lamp: float = 1.0,
    exposure_ms: float = 30.0,
    with_truth: bool = False,
    travel_share: float = 0.0,
) -> Path:
    """A sealed scan in ``folder``; returns it. ``travel_share``: of a step, travelled during each exposure."""
    plan = plan or plan_of()
    width, height = size
    scene = build_scene(config, width=width, height=height, um_per_microstep=plan.um_per_microstep)
    renderer = Renderer(scene)
    form = FrameFormat(width, height, config.bit_depth, "rgb" if config.colour else "mono")
    recipe = ScanRecipe("a" * 32, form, plan.count, plan=plan, start_time_utc="2026-01-01T00:00:00Z")
    folder.mkdir(parents=True, exist_ok=True)
    with closing(_create_in(folder.absolute(), recipe)) as scan:
        for frame_index in range(plan.count):
            position = plan.position_steps(frame_index)
            pixels = renderer.render(
                position,
                lamp=lamp,
                exposure_ms=exposure_ms,
                gain=6.0,
                brightness=0.0,
                travel_steps=travel_share * abs(plan.pitch_steps),
            )
            scan.write_frame(_header(recipe, frame_index, position, pixels), pixels)
        scan.seal(Outcome.COMPLETE, "")
    if with_truth:
        write_truth(folder / "truth.h5", truth(scene, plan.first_steps, plan.pitch_steps, plan.count))
    return folder


def _header(recipe: ScanRecipe, frame_index: int, position: int, pixels: np.ndarray) -> Image:
    return Image(
        frame_index=frame_index,
        position_steps=position,
        position_um=position * UM_PER_MICROSTEP,
        shape=list(recipe.format.shape),
        dtype=recipe.format.dtype,
        bit_depth=recipe.format.bit_depth,
        pixel_format=recipe.format.pixel_format,
        crc32=frame_crc32(pixels),
    )
