"""The stage's figures hold on the emulated pins; times of the host are left to the command."""

from __future__ import annotations

import pytest

from tests.bench.stage import bench_stage


@pytest.mark.slow
def test_the_stage_keeps_its_promises_of_rate_jitter_and_place(firmware):
    figures = bench_stage(frames=12, round_trips=20)
    assert figures["highest_step_rate_per_s"] >= 20_000
    assert figures["step_jitter_us"] <= 2
    assert figures["fly_60_trigger_jitter_us"] <= 4 and figures["fastest_fly_trigger_jitter_us"] <= 4
    assert figures["trigger_position_error_steps"] == 0
    assert figures["stack_free_bytes"] >= 0.2 * figures["ram_bytes"]
