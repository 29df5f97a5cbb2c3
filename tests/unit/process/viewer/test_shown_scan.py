"""Which scan the page shows, and what follows for the cloud and for clicks on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquire.contract.messaging.messages import ResultEnd, Status
from process.viewer.exports.results_list import ListedScan, OpenedScan
from process.viewer.panels.shown_scan import ShownScan
from process.viewer.rig_client.feed import Snapshot, TileChanges
from process.viewer.rig_client.tile import Tile

CLOUD = "/data/20260102T030405Z-frog/cloud.ply"
FINISHED = Snapshot(end=ResultEnd(version=1, outcome="complete", folded_through=9, points=5, cloud_path=CLOUD))


def tile(count: int = 1) -> Tile:
    zeros = np.zeros(count, np.float32)
    return Tile(
        (0.0, 0.0, 0.0), np.zeros((count, 3), np.float32), np.zeros((count, 3), np.uint8), zeros > 0, zeros, zeros
    )


OLD = OpenedScan(ListedScan(Path("/data/20260101T000000Z-old"), "20260101T000000Z-old", "complete", 3), {7: tile(3)})


@pytest.fixture
def shown() -> ShownScan:
    return ShownScan()


def test_the_rigs_own_changes_reach_the_cloud_as_they_come(shown: ShownScan) -> None:
    changes = TileChanges(tiles={1: tile()})
    assert shown.changes(changes) is changes


def test_an_older_scan_replaces_the_cloud_once_and_changes_of_the_rig_do_not_touch_it(shown: ShownScan) -> None:
    shown.show(OLD)
    first = shown.changes(TileChanges(tiles={1: tile()}))
    assert (first.reset, first.tiles) == (True, OLD.tiles)
    assert shown.changes(TileChanges(tiles={2: tile()})).tiles == {}


def test_going_back_to_the_rigs_own_scan_shows_what_came_meanwhile(shown: ShownScan) -> None:
    one, two, three = (tile(count) for count in (1, 2, 3))
    shown.changes(TileChanges(tiles={1: one}))
    shown.show(OLD)
    shown.changes(TileChanges(tiles={2: two}))
    shown.show(None)
    back = shown.changes(TileChanges(tiles={3: three}))
    assert (back.reset, back.tiles) == (True, {1: one, 2: two, 3: three})


def test_a_new_scan_of_the_rig_forgets_its_last_one_even_while_an_older_one_is_shown(shown: ShownScan) -> None:
    shown.changes(TileChanges(tiles={1: tile()}))
    shown.show(OLD)
    new = tile(2)
    shown.changes(TileChanges(reset=True, tiles={5: new}))
    shown.show(None)
    assert shown.changes(TileChanges()).tiles == {5: new}


def test_title_and_folder_are_those_of_the_shown_scan(shown: ShownScan) -> None:
    assert (shown.title, shown.folder) == ("no scan", None)
    shown.take(Snapshot(status=Status(state="sweeping", scan_path="/data/20260102T030405Z-frog")))
    assert (shown.title, shown.folder) == ("20260102T030405Z-frog", Path("/data/20260102T030405Z-frog"))
    shown.show(OLD)
    assert (shown.title, shown.folder) == (OLD.entry.name, OLD.entry.folder)


def test_the_points_of_a_finished_scan_are_picked_from_its_file_which_knows_their_quality(shown: ShownScan) -> None:
    live, of_file = {1: tile()}, {1: tile()}
    shown.take(FINISHED)
    assert shown.newly_finished() == CLOUD
    assert shown.newly_finished() == "", "asked for once"
    assert shown.pickable(live) is live, "until it is read"
    shown.take_finished("/data/another/cloud.ply", {})
    shown.take_finished(CLOUD, of_file)
    assert shown.pickable(live) is of_file
    shown.show(OLD)
    assert shown.pickable(OLD.tiles) is OLD.tiles
    shown.show(None)
    shown.take(Snapshot())
    assert shown.pickable(live) is live, "a new scan is running"
