"""Pictures of a running sweep, through the real daemon and writer: the newest frame, and never at the sweep's cost."""

from __future__ import annotations

import time

import pytest
import zmq

from acquire.contract.messaging.lanes import connect, receive
from acquire.contract.messaging.messages import Picture
from tests.system.appliance import Appliance
from tests.waiting import WALL_CLOCK_S

COUNT = 1578 // 12 + 1


@pytest.fixture
def appliance(run_dir, tmp_path):
    found = Appliance(run_dir, tmp_path / "scans", SIMULATION__TIME_SCALE=0.1)
    yield found
    found.close()


def test_who_looks_sees_the_sweep_and_who_never_reads_delays_nothing(appliance):
    appliance.start("daemon", "writer")
    context = zmq.Context()
    with appliance.client() as client:
        appliance.until_status(client, lambda s: s.state == "idle" and s.writer_alive, "the rig is ready")
        watcher, sleeper = (connect(context, zmq.SUB, appliance.run_dir, "preview") for _ in range(2))
        begin_s = time.monotonic()
        scan = appliance.scan(client, purpose="raw")
        assert watcher.poll(WALL_CLOCK_S * 1000)
        picture = receive(watcher).message
        status = appliance.finished(client, scan["scan_uid"])
        seconds = time.monotonic() - begin_s
    for socket in (watcher, sleeper):
        socket.close()
    context.destroy(linger=0)
    assert isinstance(picture, Picture) and picture.scan_uid == scan["scan_uid"]
    assert picture.position_steps == 12 * picture.frame_index and 0 <= picture.frame_index < COUNT
    assert status.outcome == "complete" and status.committed == COUNT
    assert 1 <= status.counters["pictures"] <= 5 * seconds + 1
