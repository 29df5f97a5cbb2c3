"""The fault table on the whole system: one point of each row here, many by ``make faults``."""

from __future__ import annotations

import pytest

from acquire.contract.faults import FAULTS
from tests import ROOT

from .firmware_rows import FIRMWARE_ROWS, daemon_killed_over_the_controller
from .harness import a_rig, run_scan
from .rows import ROWS
from .sabotage import PROTECTIONS, can_be_taken_away

ON_THE_WHOLE_SYSTEM = ("F11", "F12", "F13", "F15", "F23")
"""Rows of the controller that are shown here as well; all of them are in tests/firmware, and in ``make faults``."""


@pytest.mark.parametrize("fault", sorted([*ROWS, *ON_THE_WHOLE_SYSTEM]))
def test_the_promise_holds_under(fault):
    run_scan(fault, at=0.4, seed=int(fault[1:]))


def test_a_killed_daemon_costs_no_frame_over_the_emulated_controller_either():
    with a_rig(seed=1, at=0.4) as rig:
        daemon_killed_over_the_controller(rig)


def test_every_row_of_the_table_has_its_place():
    assert {*ROWS, *FIRMWARE_ROWS} == set(FAULTS)
    on_the_emulator = (ROOT / "tests/firmware/test_faults.py").read_text()
    for code in FIRMWARE_ROWS:
        assert f"def test_{code.lower()}_" in on_the_emulator


def test_the_texts_of_the_manual_are_those_of_the_console():
    manual = (ROOT / "docs/faults.md").read_text()
    for fault in FAULTS.values():
        assert f"| {fault.code} | {fault.happened} | {fault.safe} | {fault.to_do} |" in manual


@pytest.mark.filterwarnings("ignore:This process:DeprecationWarning")
def test_every_protection_is_still_where_it_is_taken_away():
    """Else its row would turn red for another reason: a service that does not start."""
    import process.worker.service  # noqa: F401 - loaded once here, not in each child

    assert [name for name in PROTECTIONS if not can_be_taken_away(name)] == []


def test_a_harness_that_lost_a_protection_says_so():
    with pytest.raises(AssertionError, match="another one than the rig showed"):
        run_scan("F17", at=0.4, seed=1, sabotage="pairing")
