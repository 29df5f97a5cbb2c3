"""What every sweep keeps, whatever happens to it: random sequences of events against the pure state machine."""

from __future__ import annotations

from collections import Counter

import pytest

from acquire.contract.frame_ranges import indices_of
from acquire.contract.scan_data.checksums import scan_digest
from acquire.contract.states import IllegalTransitionError, Outcome
from acquire.sweep import sweep_state
from acquire.sweep.phases import TRANSITIONS, Decision, Phase, next_phase
from tests.property.sweep_world import SweepWorld

SEQUENCES = 2000
ROWS = {(phase, decision) for phase, row in TRANSITIONS.items() for decision in row}


@pytest.fixture(scope="module")
def runs():
    """Every world after its run, and the rows of the table that were taken."""
    taken: Counter[tuple[Phase, Decision]] = Counter()

    def recorded(phase: Phase, decision: Decision) -> Phase:
        taken[phase, decision] += 1
        return next_phase(phase, decision)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sweep_state, "next_phase", recorded)
        worlds = [SweepWorld(seed) for seed in range(SEQUENCES)]
        for world in worlds:
            world.run()
    return worlds, taken


def test_every_sweep_comes_to_its_end(runs):
    worlds, _ = runs
    assert [seed for seed, world in enumerate(worlds) if world.sweep.phase is not Phase.DONE] == []


def test_every_frame_is_committed_or_named_as_missing(runs):
    worlds, _ = runs
    for seed, world in enumerate(worlds):
        if world.end is not None:
            missing = set(indices_of(world.end.missing))
            assert missing == set(range(world.sweep.count)) - set(world.file), seed


def test_the_stage_is_stopped_at_the_end(runs):
    worlds, _ = runs
    assert [seed for seed, world in enumerate(worlds) if world.segment is not None] == []


def test_nothing_is_called_complete_that_is_not(runs):
    worlds, _ = runs
    complete = [world for world in worlds if world.sweep.outcome is Outcome.COMPLETE]
    assert len(complete) > SEQUENCES / 4
    for world in complete:
        assert world.end is not None and world.end.missing == []
        assert world.end.digest == scan_digest([world.file[k] for k in range(world.sweep.count)])


def test_what_a_sweep_says_of_its_frames_is_what_the_file_holds(runs):
    worlds, _ = runs
    for seed, world in enumerate(worlds):
        known = world.sweep.window.committed
        assert known == {k: world.file[k] for k in known}, seed


def test_each_row_of_the_table_of_transitions_is_taken(runs):
    _, taken = runs
    assert {f"{phase.name} {decision.name}" for phase, decision in ROWS - set(taken)} == set()


@pytest.mark.parametrize("phase", Phase)
def test_a_transition_that_the_table_does_not_have_raises(phase):
    for decision in set(Decision) - set(TRANSITIONS[phase]):
        with pytest.raises(IllegalTransitionError, match=decision.name):
            next_phase(phase, decision)
