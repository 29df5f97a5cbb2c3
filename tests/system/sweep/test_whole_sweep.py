"""Whole sweeps through the real services, with one of them killed, frozen or missing; the file is the judge."""

from __future__ import annotations

import json
import signal
import threading
from pathlib import Path

import h5py
import numpy as np
import pytest

from acquire.contract.config.load import load_config
from acquire.contract.errors import CommandRefusedError
from acquire.contract.scan_data.dataset_names import FrameStatus
from acquire.contract.scan_data.reader import ScanReader
from acquire.simulation import Renderer, build_scene
from acquire.writer.verify import verify
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.system.appliance import SMALL, Appliance
from tui.client.rig_client import ProgressFeed

COUNT = 1578 // 12 + 1


@pytest.fixture
def appliance(run_dir, tmp_path):
    found = Appliance(run_dir, tmp_path / "scans")
    yield found
    found.close()


@pytest.fixture(scope="module")
def expected_frames():
    """What the optics show at each position: rendered here, by nothing that the services had a hand in."""
    rig = load_config(environ={f"SWEEPSCOPE_{k}": str(v) for k, v in SMALL.items()}).rig
    scene = build_scene(rig.simulation, width=128, height=96, um_per_microstep=rig.stage.um_per_microstep)
    renderer = Renderer(scene)
    camera = rig.camera
    return [
        renderer.render(12 * k, exposure_ms=camera.exposure_ms, gain=camera.gain, brightness=camera.brightness_percent)
        for k in range(COUNT)
    ]


def assert_frames(folder, expected, count=COUNT):
    """Each committed frame is in the file, bit for bit, at its place; nothing else is called committed."""
    with ScanReader(Path(folder)) as reader:
        status = reader.status()
        assert np.isin(status[:count], (FrameStatus.GOOD, FrameStatus.RETAKEN)).all()
        assert not status[count:].any()
        assert np.array_equal(reader.field("position_steps")[:count], 12 * np.arange(count))
        for k in range(count):
            assert np.array_equal(reader.frame(k), expected[k]), f"frame {k} is another one"


def assert_live_equals_reconstruct(folder, tmp_path):
    folder = Path(folder)
    reconstruct(folder, ReconstructOptions(out=tmp_path / "again"))
    assert (folder / "cloud.ply").read_bytes() == (tmp_path / "again/cloud.ply").read_bytes()
    with h5py.File(folder / "maps.h5") as live, h5py.File(tmp_path / "again/maps.h5") as again:
        names = [name for name in live if isinstance(live[name], h5py.Dataset)]
        assert set(live) == set(again) and len(names) == 7
        for name in names:
            assert np.array_equal(live[name][()], again[name][()], equal_nan=live[name].dtype.kind == "f"), name


def results_of(appliance, folder, outcome="complete"):
    """The final report: the outcome is known, and the comparison with the truth is made."""
    path = Path(folder) / "report.json"

    def final():
        report = json.loads(path.read_text()) if path.exists() else {}
        return report if report.get("outcome") == outcome and report.get("truth") else None

    return appliance.until(final, "the final report")


def wait_for_worker(appliance):
    """It speaks once its kernels are compiled; a sweep that begins before is folded from the file."""
    feed = ProgressFeed(appliance.run_dir)
    try:
        appliance.until(lambda: feed.newest() is not None, "the worker is ready")
    finally:
        feed.close()


def test_an_undisturbed_sweep_is_complete_exact_and_folded_live(appliance, expected_frames, tmp_path):
    appliance.start("daemon", "writer", "worker")
    wait_for_worker(appliance)
    with appliance.client() as client:
        scan = appliance.scan(client)
        status = appliance.finished(client, scan["scan_uid"])
    assert status.outcome == "complete" and status.committed == COUNT and status.missing == 0
    assert "SAVED" in status.message
    assert_frames(scan["path"], expected_frames)
    report = results_of(appliance, scan["path"])
    assert report["counts"]["from_live"] >= 0.8 * COUNT  # the rest is refolded from the file when the machine is busy
    assert report["counts"]["points"] > 300 and report["truth"]["median_um"] < 3
    assert_live_equals_reconstruct(scan["path"], tmp_path)
    checked = verify(Path(scan["path"]))
    assert checked.ok and checked.complete


def test_a_worker_that_is_killed_twice_ends_with_the_identical_result(appliance, expected_frames, tmp_path):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer", "worker")
    with appliance.client() as client:
        scan = appliance.scan(client)
        for share in (0.2, 0.5):
            appliance.until_status(client, lambda s, share=share: s.committed > share * COUNT, "frames are committed")
            appliance.kill("worker")
            appliance.start("worker")
        assert appliance.finished(client, scan["scan_uid"]).outcome == "complete"
    assert_frames(scan["path"], expected_frames)
    results_of(appliance, scan["path"])
    assert_live_equals_reconstruct(scan["path"], tmp_path)


def test_a_writer_that_is_killed_and_comes_back_leaves_no_gap_and_no_duplicate(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.1"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 30, "frames are committed")
        appliance.kill("writer")
        partial = Path(scan["path"]) / "scan.partial.h5"
        with h5py.File(partial, "r") as file:
            assert file["entry/data/data"].shape[0] == COUNT
        appliance.start("writer")
        status = appliance.finished(client, scan["scan_uid"])
    assert status.outcome == "complete" and status.committed == COUNT
    assert_frames(scan["path"], expected_frames)


def test_a_frozen_writer_stops_the_stage_and_nothing_is_lost(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_LIMITS__WINDOW_BYTES"] = "1000000"
    appliance.start("daemon", "writer")
    slots = 1_000_000 // (128 * 96 * 3)
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 5, "frames are committed")
        appliance.send_signal("writer", signal.SIGSTOP)
        held = appliance.until_status(client, lambda s: s.hold_reason == "no credit", "the stage holds")
        assert held.triggered - held.committed <= slots
        appliance.until_status(client, lambda s: any(f.code == "F03" for f in s.faults), "the operator is told")
        appliance.send_signal("writer", signal.SIGCONT)
        assert appliance.finished(client, scan["scan_uid"]).outcome == "complete"
    assert_frames(scan["path"], expected_frames)


def test_pause_resume_and_stop_keep_what_was_taken(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 10, "frames are committed")
        assert client.request("pause").ok
        paused = appliance.until_status(client, lambda s: s.hold_reason == "paused", "it holds")
        assert paused.state == "holding"
        assert client.request("resume").ok
        appliance.until_status(client, lambda s: s.committed > paused.committed + 5, "it goes on")
        assert client.request("stop").ok
        status = appliance.finished(client, scan["scan_uid"])
    assert status.outcome == "stopped" and 0 < status.committed < COUNT
    assert status.missing == COUNT - status.committed
    assert_frames(scan["path"], expected_frames, status.committed)
    with ScanReader(Path(scan["path"])) as reader:
        assert reader.layout.path.name == "scan.h5" and reader.outcome == "stopped"


def test_without_a_writer_a_scan_is_refused_in_time_and_nothing_moves(appliance):
    appliance.environ["SWEEPSCOPE_LIMITS__WRITER_START_S"] = "0.5"
    appliance.start("daemon")
    with appliance.client() as client:
        scan = appliance.scan(client)
        status = appliance.finished(client, scan["scan_uid"])
    assert status.outcome == "failed" and status.triggered == 0
    assert [fault.code for fault in status.faults] == ["F05"]
    assert not Path(scan["path"]).exists()


def test_a_daemon_that_is_told_to_end_in_mid_sweep_seals_what_there_is(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 10, "frames are committed")
    assert appliance.end("daemon") == 0
    with ScanReader(Path(scan["path"])) as reader:
        assert reader.outcome == "aborted" and "F24" in str(reader.scalar("reason"))
        count = int(reader.present().sum())
    assert_frames(scan["path"], expected_frames, count)


def test_an_interrupted_sweep_is_resumed_and_equals_an_undisturbed_one(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 40, "frames are committed")
    appliance.kill("daemon")
    assert_partial(scan["path"])
    appliance.start("daemon")
    with appliance.client() as client:
        ready = appliance.until_status(client, lambda s: s.state == "idle" and s.writer_alive, "the rig is ready")
        assert (ready.scan_uid, ready.outcome, ready.expected) == (scan["scan_uid"], "interrupted", COUNT)
        (fault,) = ready.faults
        assert (fault.code, fault.scan, fault.acknowledged) == ("F01", Path(scan["path"]).name, False)
        assert fault.safe == f"{ready.committed} of {COUNT} frames are saved" and ready.committed > 40
        again = client.request("resume_scan", path=scan["path"]).result
        assert again["scan_uid"] == scan["scan_uid"]
        status = appliance.finished(client, scan["scan_uid"])
        assert not status.faults
    assert status.outcome == "complete" and status.triggered < COUNT - 30
    assert_frames(scan["path"], expected_frames)
    assert (Path(scan["path"]) / "overlap.png").exists()


def test_a_sweep_that_was_stopped_goes_on_and_equals_an_undisturbed_one(appliance, expected_frames, tmp_path):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer", "worker")
    with appliance.client() as client:
        scan = appliance.scan(client)
        for committed in (30, 60):
            appliance.until_status(client, lambda s, n=committed: s.committed > n, "frames are committed")
            client.request("stop")
            stopped = appliance.finished(client, scan["scan_uid"])
            assert stopped.outcome == "stopped" and (Path(scan["path"]) / "scan.h5").exists()
            results_of(appliance, scan["path"], "stopped")
            assert client.request("resume_scan", path=scan["path"]).result["scan_uid"] == scan["scan_uid"]
            appliance.until_status(client, lambda s: s.outcome == "running", "the sweep goes on")
        assert appliance.finished(client, scan["scan_uid"]).outcome == "complete"
    assert_frames(scan["path"], expected_frames)
    results_of(appliance, scan["path"])
    assert_live_equals_reconstruct(scan["path"], tmp_path)


def assert_partial(folder):
    with ScanReader(Path(folder)) as reader:
        assert reader.layout.path.name == "scan.partial.h5" and reader.outcome in ("running", "interrupted")


def test_a_specimen_that_moved_meanwhile_is_noticed_and_the_scan_stays_as_it_was(appliance, expected_frames):
    appliance.environ["SWEEPSCOPE_SIMULATION__TIME_SCALE"] = "0.2"
    appliance.environ["SWEEPSCOPE_SWEEP__MAX_RATE_HZ"] = "15"
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.until_status(client, lambda s: s.committed > 60, "frames are committed")
    appliance.kill("daemon")
    appliance.environ["SWEEPSCOPE_SIMULATION__SPECIMEN_MOVED_UM"] = "[40.0, 0.0, 0.0]"
    appliance.start("daemon")
    with appliance.client() as client:
        appliance.until_status(client, lambda s: s.state == "idle" and s.writer_alive, "the rig is ready")
        client.request("resume_scan", path=scan["path"])
        status = appliance.finished(client, scan["scan_uid"])
    assert status.outcome == "interrupted" and "cannot go on" in status.faults[0].happened
    with ScanReader(Path(scan["path"])) as reader:
        count = int(reader.present().sum())
    assert_partial(scan["path"])
    assert_frames(scan["path"], expected_frames, count)


def test_a_scan_that_is_closed_cannot_be_resumed(appliance):
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        scan = appliance.scan(client)
        appliance.finished(client, scan["scan_uid"])
        with pytest.raises(CommandRefusedError, match="closed for good"):
            client.request("resume_scan", path=scan["path"])


def test_a_command_that_a_frozen_daemon_finds_late_is_not_done(appliance):
    appliance.environ["SWEEPSCOPE_LIMITS__COMMAND_S"] = "0.3"
    appliance.start("daemon")
    with appliance.client() as client:
        appliance.until_status(client, lambda s: s.state == "idle", "the rig is ready")
        appliance.send_signal("daemon", signal.SIGSTOP)
        thaw = threading.Timer(1.0, appliance.send_signal, ("daemon", signal.SIGCONT))
        thaw.start()
        client._timeout_s = 10.0
        with pytest.raises(CommandRefusedError, match="late and was not done"):
            client.request("goto", position_steps=500)
        thaw.join()
        assert client.request("status").result["position_steps"] == 0


def test_a_second_daemon_leaves_with_the_pid_of_the_first(appliance):
    appliance.start("daemon")
    with appliance.client() as client:
        first = appliance.processes["daemon"]
        appliance.start("daemon")
        assert appliance.processes["daemon"].wait(30) == 1
        assert f"pid {first.pid}" in appliance.log.read_text()
        assert client.request("status").ok
    appliance.processes["daemon"] = first


@pytest.mark.parametrize(
    ("args", "words"),
    [
        ({"first_steps": -50}, "travel"),
        ({"first_steps": 9999999}, "travel"),
        ({"mode": "fly"}, "step mode"),
        ({"steps_per_frame": 0}, "steps_per_frame"),
    ],
)
def test_a_scan_that_cannot_go_well_is_refused_with_a_reason(appliance, args, words):
    appliance.start("daemon", "writer")
    with appliance.client() as client:
        with pytest.raises(CommandRefusedError, match=words):
            client.request("scan", name="x", **args)
        assert client.request("status").result["state"] == "idle"
