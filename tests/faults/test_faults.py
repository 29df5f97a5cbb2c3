"""The fault table on the whole system: one point of each row here, many by ``make faults``."""

from __future__ import annotations

import pytest

from acquire.contract.faults import FAULTS

from .harness import run_scan
from .rows import FIRMWARE_ROWS, ROWS


@pytest.mark.parametrize("fault", ROWS)
def test_the_promise_holds_under(fault):
    run_scan(fault, at=0.4, seed=int(fault[1:]))


def test_every_row_of_the_table_has_its_place():
    assert {*ROWS, *FIRMWARE_ROWS} == set(FAULTS)
