"""The record of the emulated pins is for looking at afterwards: nothing waits for it or ends with it."""

from __future__ import annotations

from pathlib import Path

from acquire.rigs.twin import PairedEdges
from acquire.stages.protocol import Triggered
from acquire.stages.uno.emulator import TriggerEdge


def test_a_folder_that_takes_no_record_is_no_obstacle(tmp_path):
    PairedEdges(lambda *_shot: None, 0, 3.175).record_to(tmp_path / "gone" / "pins")


def test_a_full_disk_ends_the_record_of_the_pins_and_not_the_exposures():
    exposed = []
    pairs = PairedEdges(lambda *shot: exposed.append(shot[0]), zero_at=0, um_per_microstep=3.175)
    pairs.record_to(Path("/dev/full"))
    for k in range(3):
        pairs.edge(TriggerEdge(k, 3 * k, 100 * k), delivered=True)
        pairs.reported(Triggered(k, k, 3 * k))
    pairs.record_to(None)
    assert exposed == [0, 3, 6]
