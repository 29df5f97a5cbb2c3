"""The rows of the fault table that a simulated rig can show: each injects its fault and asserts the promise.

Order of the assertions: the data first, then the state, then the operator's message, then the counters.
"""

from __future__ import annotations

import json
import resource
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Status
from acquire.contract.scan_data.reader import ScanReader
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.fakes.bombs import hit
from tests.needs import missing_here
from tui.client.rig_client import RigClient

from .clock import wall_clock_library
from .harness import COUNT, EXPOSED_SHARE, FRAME_BYTES, PACED, START_S, Rig, assert_frames, assert_promise
from .small_disk import small_disk, why_not

Row = Callable[[Rig], None]
COMPILING_S = 180.0


def complete(rig: Rig, client: RigClient, scan: dict[str, Any]) -> Status:
    """The sweep ends as complete, and the promise holds."""
    status = rig.finished(client, scan["scan_uid"])
    assert_promise(Path(scan["path"]), rig, "complete")
    assert status.outcome == "complete" and "SAVED" in status.message
    return status


def outcome_in_file(scan: dict[str, Any]) -> str:
    """What the scan's file says of its end; empty where there is none."""
    try:
        with ScanReader(Path(scan["path"])) as reader:
            return reader.outcome
    except Exception:
        return ""


def resume(rig: Rig, client: RigClient, scan: dict[str, Any]) -> None:
    """Go on with a scan as soon as nobody owns it any more."""
    rig.ready(client)

    def accepted() -> bool:
        try:
            return client.request("resume_scan", path=scan["path"]).ok
        except CommandRefusedError as error:
            # the writer still looks after the scan: its lock names it
            if "already running" not in str(error):
                raise
            return False

    rig.until(accepted, "the scan is free to be resumed")


def daemon_killed(rig: Rig) -> None:
    """F01: partial, exact, marked as interrupted without anybody's doing; resumed, it is complete."""
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        rig.kill("daemon")
    rig.until(lambda: outcome_in_file(scan) == "interrupted", "the scan is marked as interrupted")
    assert_promise(Path(scan["path"]), rig, "interrupted")
    rig.start("daemon")
    with rig.client() as client:
        resume(rig, client, scan)
        complete(rig, client, scan)


def daemon_frozen(rig: Rig) -> None:
    """F02: the sweep goes on without a double step, and the operator is told."""
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        rig.freeze("daemon", 1.3 + rig.random.random())
        status = complete(rig, client, scan)
    assert "frozen" in rig.seen[scan["scan_uid"]].faults.get("F02", "")
    assert status.triggered <= COUNT + status.retaken + status.counters["check_triggers"]


def writer_killed(rig: Rig) -> None:
    """F03: whatever the dead writer's file calls committed is exact; with its successor nothing is missing."""
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        rig.kill("writer")
        assert_frames(Path(scan["path"]), rig.light)
        rig.start("writer")
        complete(rig, client, scan)


def writer_frozen(rig: Rig) -> None:
    """F04: the stage waits, memory stays within the window, the sweep goes on."""
    slots = 30
    rig.set(LIMITS__WINDOW_BYTES=slots * FRAME_BYTES)
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.at *= 0.5
        rig.moment(client)
        before = rig.rss("daemon")
        rig.send_signal("writer", signal.SIGSTOP)
        try:
            held = rig.until_status(client, lambda s: s.hold_reason == "no credit", "the stage holds")
            assert held.triggered - held.committed <= slots
            assert rig.rss("daemon") - before < 2 * slots * FRAME_BYTES + 20_000_000
            rig.told(client, "F03")
        finally:
            rig.send_signal("writer", signal.SIGCONT)
        complete(rig, client, scan)


def writer_never_started(rig: Rig) -> None:
    """F05: refused in time, nothing has moved, nothing is left behind."""
    rig.set(LIMITS__WRITER_START_S=0.5)
    rig.start("daemon")
    with rig.client() as client:
        scan = rig.scan(client)
        status = rig.finished(client, scan["scan_uid"])
    assert not Path(scan["path"]).exists()
    assert status.outcome == "failed" and status.triggered == 0 and status.position_steps == 0
    assert "start the writer" in rig.seen[scan["scan_uid"]].faults["F05"]


def disk_full(rig: Rig) -> None:
    """F06: too small a disk is found before anything moves; one that fills up later holds the sweep."""
    rig.environ["SWEEPSCOPE_TEST_INJECT"] = "ENOSPC"
    rig.start("daemon", "writer")
    with rig.client() as client:
        rig.ready(client)
        pid = rig.processes["writer"].pid
        unlimited = resource.prlimit(pid, resource.RLIMIT_FSIZE, (1_000_000, resource.RLIM_INFINITY))
        refused = rig.scan(client, name="small")
        status = rig.finished(client, refused["scan_uid"])
        assert not Path(refused["path"]).exists()
        assert status.outcome == "failed" and status.triggered == 0
        assert "make room" in rig.seen[refused["scan_uid"]].faults["F06"]
        resource.prlimit(pid, resource.RLIMIT_FSIZE, unlimited)
        client.request("acknowledge")
        scan = rig.begin(client)
        rig.moment(client)
        rig.flag.touch()
        rig.told(client, "F06")
        assert_frames(Path(scan["path"]), rig.light)
        rig.flag.unlink()
        complete(rig, client, scan)
    for service in ("daemon", "writer"):
        rig.kill(service)
    _small_disk_full(rig)


def _small_disk_full(rig: Rig) -> None:
    """On a real disk of 40 MB: refused before it moves; what is reserved is there though the disk fills up."""
    if why := why_not():
        missing_here(f"no disk of 40 MB can be mounted for this process alone: {why}")
    with small_disk(rig) as disk:
        rig.start("daemon", "writer")
        with rig.client() as client:
            rig.ready(client)
            disk.fill(leave_bytes=2_000_000)
            with pytest.raises(CommandRefusedError, match="make room"):
                rig.scan(client, name="refused")
            disk.make_room()
            scan = rig.begin(client)
            rig.moment(client)
            disk.fill(leave_bytes=0)
            status = rig.finished(client, scan["scan_uid"])
        assert_promise(disk.outside(scan["path"]), rig, "complete")
        assert status.outcome == "complete" and "F06" not in rig.seen[scan["scan_uid"]].faults
        rig.close()


def disk_broken(rig: Rig) -> None:
    """F07: an I/O error holds the sweep until the disk is repaired; a file that is gone is said to be gone."""
    rig.set(LIMITS__SEAL_S=4.0)
    rig.environ["SWEEPSCOPE_TEST_INJECT"] = "EIO"
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        rig.flag.touch()
        assert "repair" in rig.told(client, "F07")
        assert_frames(Path(scan["path"]), rig.light)
        rig.flag.unlink()
        complete(rig, client, scan)
        client.request("acknowledge")
        gone = rig.begin(client, name="gone", steps_per_frame=3)
        rig.moment(client)
        (Path(gone["path"]) / "scan.partial.h5").unlink()
        rig.until_status(client, lambda s: any("file was deleted" in f.happened for f in s.faults), "F07 names it")
        client.request("stop")
        status = rig.finished(client, gone["scan_uid"])
        assert status.outcome in ("interrupted", "failed") and "SAVED" not in status.message


def _same_results(folder: Path, rig: Rig) -> None:
    again = rig.data_dir.parent / "again"
    reconstruct(folder, ReconstructOptions(out=again))
    assert (folder / "cloud.ply").read_bytes() == (again / "cloud.ply").read_bytes()
    with h5py.File(folder / "maps.h5") as live, h5py.File(again / "maps.h5") as offline:
        for name in (name for name in offline if isinstance(offline[name], h5py.Dataset)):
            assert np.array_equal(live[name][()], offline[name][()], equal_nan=live[name].dtype.kind == "f"), name


def _with_results(rig: Rig, scan: dict[str, Any]) -> None:
    report = Path(scan["path"]) / "report.json"
    # on a machine where it never ran, the worker compiles its kernels first
    deadline_s = rig.deadline_s + (0 if rig.sabotage else COMPILING_S)
    rig.until(
        lambda: report.exists() and json.loads(report.read_text())["outcome"] == "complete",
        "the worker's results",
        deadline_s,
    )
    _same_results(Path(scan["path"]), rig)


def worker_killed(rig: Rig) -> None:
    """F08: the sweep does not notice; the next worker ends with the identical result, also where it heard lies."""
    rig.environ["SWEEPSCOPE_TEST_INJECT"] = "the live lane lies"
    rig.start("daemon", "writer", "worker")
    with rig.client() as client:
        rig.until((rig.run_dir / "results.sock").exists, "the worker is up", START_S)
        scan = rig.begin(client)
        rig.moment(client)
        rig.kill("worker")
        rig.start("worker")
        complete(rig, client, scan)
        _with_results(rig, scan)
        rig.flag.touch()
        lied = rig.begin(client, name="lied")
        complete(rig, client, lied)
        _with_results(rig, lied)
    report = json.loads((Path(lied["path"]) / "report.json").read_text())
    assert report["counts"]["refolded"] == COUNT


def worker_frozen(rig: Rig) -> None:
    """F09: the sweep does not notice a worker that stands still; it ends with the identical result."""
    rig.start("daemon", "writer", "worker")
    with rig.client() as client:
        rig.until((rig.run_dir / "results.sock").exists, "the worker is up", START_S)
        scan = rig.begin(client)
        rig.at *= 0.2
        rig.moment(client)
        rig.send_signal("worker", signal.SIGSTOP)
        try:
            status = complete(rig, client, scan)
        finally:
            rig.send_signal("worker", signal.SIGCONT)
        assert status.counters["holds_no_credit"] == 0
    _with_results(rig, scan)


def clients_come_and_go(rig: Rig) -> None:
    """F10: fifty clients connect, ask and vanish; the next one sees the whole state."""
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        for _ in range(50):
            with RigClient(rig.run_dir, timeout_s=rig.deadline_s) as visitor:
                assert visitor.request("status").result["scan_uid"] == scan["scan_uid"]
        complete(rig, client, scan)


def _scripted(rig: Rig, verbs: tuple[str, ...]) -> tuple[dict[str, Any], Status]:
    exposure = 5 + int(rig.at * (COUNT - 25))
    rig.set(SIMULATION__FAULTS=",".join(f"{verb}:{exposure + 4 * k}" for k, verb in enumerate(verbs)))
    rig.set(CAMERA__FRAME_TIMEOUT_MS=300)
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        return scan, complete(rig, client, scan)


def frames_lost(rig: Rig) -> None:
    """F16: a lost trigger and a lost frame are found and taken again at the same position, marked."""
    _seen_by_nobody_on_the_fly(rig)
    rig.kill("daemon")
    rig.kill("writer")
    scan, status = _scripted(rig, ("lose", "skip"))
    with ScanReader(Path(scan["path"])) as reader:
        assert int((reader.status() == 2).sum()) == status.retaken
    assert status.counters["lost"] >= 2 and (status.retaken >= 1 if rig.flies else status.retaken == 2)


def _seen_by_nobody_on_the_fly(rig: Rig) -> None:
    """No id is used up by a trigger that the camera does not see: the frames behind it must not move up."""
    unseen = 5 + int(rig.at * (COUNT - 25))
    rig.set(SIMULATION__FAULTS=f"skip:{unseen}", CAMERA__FRAME_TIMEOUT_MS=300, SIMULATION__TIME_SCALE=0.3)
    before, rig.light.on_the_fly = rig.light.on_the_fly, EXPOSED_SHARE
    rig.start("daemon", "writer")
    with rig.client() as client:
        status = complete(rig, client, rig.begin(client, mode="fly"))
    assert status.retaken >= 1
    rig.light.on_the_fly = before
    rig.set(**PACED)


def frames_extra(rig: Rig) -> None:
    """F17: what nobody triggered is counted and dropped, nothing is paired by guess."""
    _scan, status = _scripted(rig, ("extra", "double", "late", "stray"))
    assert status.counters["extra"] >= 3


def camera_restarts(rig: Rig) -> None:
    """F18: ids start again; the frame is re-taken."""
    scan, status = _scripted(rig, ("restart",))
    assert status.retaken >= 1 if rig.flies else status.retaken == 1
    assert "re-taken" in rig.seen[scan["scan_uid"]].faults["F18"]


def frames_of_another_shape(rig: Rig) -> None:
    """F19: refused and re-taken or sent again; a camera that does nothing else is a fault with a name."""
    rig.environ["SWEEPSCOPE_TEST_INJECT"] = "bits flip"
    first, status = _scripted(rig, ("shape", "type"))
    assert status.counters["damaged"] == 2 and (status.retaken >= 1 if rig.flies else status.retaken == 2)
    assert "on its way to the writer" in rig.seen[first["scan_uid"]].faults["F19"]
    rig.kill("daemon")
    exposure = 5 + int(rig.at * (COUNT - 25))
    rig.set(SIMULATION__FAULTS=",".join(f"shape:{exposure + k}" for k in range(COUNT)))
    rig.start("daemon")
    with rig.client() as client:
        scan = rig.begin(client)
        status = rig.finished(client, scan["scan_uid"])
    assert_promise(Path(scan["path"]), rig, "failed")
    assert "camera" in rig.seen[scan["scan_uid"]].faults["F19"]


def hostile_messages(rig: Rig) -> None:
    """F20: bombs on every socket during a sweep are counted and ignored."""
    rig.start("daemon", "writer", "worker")
    with rig.client() as client:
        rig.until((rig.run_dir / "results.sock").exists, "the worker is up", START_S)
        scan = rig.begin(client)
        rig.at *= 0.3
        rig.moment(client)
        before = rig.rss("daemon")
        sent = hit(rig.run_dir, count=300, seed=rig.seed)
        status = complete(rig, client, scan)
        assert client.request("status").ok
        assert rig.rss("daemon") - before < 100_000_000
        assert all(process.poll() is None for process in rig.processes.values()), "a service died"
        assert sent["results"] and sent["command"] and sent["frames"] and status.counters["malformed"] > 0


def calibration_unusable(rig: Rig) -> None:
    """F21: refused by name before anything moves; a scan keeps the calibration that it was begun with."""
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        complete(rig, client, scan)
    with ScanReader(Path(scan["path"])) as reader:
        good = json.loads(reader.layout.verbatim["calibration"])
    path = rig.data_dir.parent / "calibration.json"
    nan = json.loads(json.dumps(good))
    nan["light_plane"]["normal"] = [0, 0, 0]
    other = json.loads(json.dumps(good))
    other["camera"]["width"] += 1
    rig.set(RECONSTRUCT__CALIBRATION=path)
    rig.kill("daemon")
    rig.start("daemon")
    with rig.client() as client:
        rig.ready(client)
        path.unlink(missing_ok=True)
        for words, text in (("calibration", None), ("normal", nan), ("128", other), ("NaN|finite|JSON", "nan")):
            if text is not None:
                path.write_text(text if isinstance(text, str) else json.dumps(text))
            with pytest.raises(CommandRefusedError, match=words):
                rig.scan(client)
        path.write_text(json.dumps(good))
        scan = rig.begin(client)
        rig.moment(client)
        path.write_text("{}")
        complete(rig, client, scan)
    with ScanReader(Path(scan["path"])) as reader:
        assert json.loads(reader.layout.verbatim["calibration"]) == good


def clock_jumps(rig: Rig) -> None:
    """F22: the wall clock jumps by an hour, forth and back; no time-out fires, and it is noted."""
    rig.environ["LD_PRELOAD"] = str(wall_clock_library(rig.data_dir.parent))
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        rig.flag.touch()
        rig.told(client, "F22")
        rig.flag.unlink()
        status = complete(rig, client, scan)
    faults = rig.seen[scan["scan_uid"]].faults
    assert "3600" not in faults.get("F02", ""), "the jump was taken for a freeze"
    assert not {"F12", "F16"} & set(faults) and status.counters["lost"] == 0, "a time-out fired"
    with ScanReader(Path(scan["path"])) as reader:
        assert np.all(np.diff(reader.field("exposure_start_ns")) > 0)


def told_to_end(rig: Rig) -> None:
    """F24: SIGTERM, or Ctrl-C three times, in each state, with cleanup steps that fail: an honest end and status 0."""
    which = list(_STATES)[(rig.seed + int(10 * rig.at)) % len(_STATES)]
    if rig.random.random() < 0.5:
        rig.environ["SWEEPSCOPE_TEST_INJECT"] = "cleanup fails"
    rig.set(LAMP__WARM_UP_S=0 if which != "armed" else 600)
    rig.set(LIMITS__WINDOW_BYTES=30 * FRAME_BYTES)
    rig.start("daemon", "writer")
    rig.at *= 0.3
    with rig.client() as client:
        rig.ready(client)
        scan = _STATES[which](rig, client)
    process = rig.processes["daemon"]
    if rig.random.random() < 0.5:
        for _ in range(2):
            rig.send_signal("daemon", signal.SIGINT)
    rig.send_signal("daemon", signal.SIGTERM)
    if which == "no credit":
        rig.pause(0.3)
        rig.send_signal("writer", signal.SIGCONT)
    rig.until(lambda: process.poll() is not None, f"it leaves when told so while {which}")
    assert process.returncode == 0, f"told to end while {which} it left with another status"
    if not scan:
        return
    assert_promise(Path(scan["path"]), rig, "aborted")
    with ScanReader(Path(scan["path"])) as reader:
        assert "F24" in str(reader.scalar("reason"))


def _moving(rig: Rig, client: RigClient) -> dict[str, Any]:
    client.request("goto", position_steps=4000)
    return {}


def _armed(rig: Rig, client: RigClient) -> dict[str, Any]:
    scan = rig.begin(client)
    rig.until((Path(scan["path"]) / "scan.partial.h5").exists, "the file is made")
    return scan


def _sweeping(rig: Rig, client: RigClient) -> dict[str, Any]:
    scan = rig.begin(client)
    rig.moment(client)
    return scan


def _paused(rig: Rig, client: RigClient) -> dict[str, Any]:
    scan = _sweeping(rig, client)
    client.request("pause")
    rig.until_status(client, lambda s: s.state == "holding", "it holds")
    return scan


def _without_credit(rig: Rig, client: RigClient) -> dict[str, Any]:
    scan = _sweeping(rig, client)
    rig.send_signal("writer", signal.SIGSTOP)
    rig.until_status(client, lambda s: s.hold_reason == "no credit", "the stage holds")
    return scan


_STATES: dict[str, Callable[[Rig, RigClient], dict[str, Any]]] = {
    "idle": lambda _rig, _client: {},
    "moving": _moving,
    "armed": _armed,
    "sweeping": _sweeping,
    "paused": _paused,
    "no credit": _without_credit,
}


def everything_killed(rig: Rig) -> None:
    """F25: all at once, a frame torn on the disk; they come up in any order and the scan goes on by one command."""
    rig.set(STORAGE__SYNC_EVERY_FRAMES=100_000)
    services = ["daemon", "writer"]
    rig.start(*services)
    with rig.client() as client:
        scan = rig.begin(client)
        rig.moment(client)
        for service in services:
            rig.send_signal(service, signal.SIGKILL)
    for service in services:
        rig.kill(service)
    torn = _tear_the_last_frame(Path(scan["path"]))
    rig.random.shuffle(services)
    rig.start(*services)
    rig.until(lambda: outcome_in_file(scan) == "interrupted", "the scan is marked as interrupted")
    rig.seen.clear()  # what was acked before the frame was torn by hand is no witness any more
    rig.until(lambda: not _is_present(scan, torn), "the torn frame is found")
    assert_promise(Path(scan["path"]), rig, "interrupted")
    with rig.client() as client:
        resume(rig, client, scan)
        complete(rig, client, scan)


def _tear_the_last_frame(folder: Path) -> int:
    with ScanReader(folder) as reader:
        last = int(np.flatnonzero(reader.present())[-1])
        offset, path = reader.layout.frame_offset(last), reader.layout.path
    with path.open("r+b") as file:
        file.seek(offset + FRAME_BYTES // 2)
        file.write(bytes(reversed(range(256))) * 8)
    return last


def _is_present(scan: dict[str, Any], frame_index: int) -> bool:
    with ScanReader(Path(scan["path"])) as reader:
        return bool(reader.present()[frame_index])


def two_of_a_kind(rig: Rig) -> None:
    """F26: a second daemon, writer or worker leaves with the pid of the first; the sweep does not notice."""
    rig.start("daemon", "writer", "worker")
    with rig.client() as client:
        rig.until((rig.run_dir / "results.sock").exists, "the worker is up", START_S)
        scan = rig.begin(client)
        first = dict(rig.processes)
        rig.start("daemon", "writer", "worker")
        second = dict(rig.processes)
        try:
            for name, process in second.items():
                rig.until(lambda process=process: process.poll() is not None, f"a second {name} leaves")
                assert process.returncode == 1, f"a second {name} did not leave"
                assert f"pid {first[name].pid}" in rig.log.read_text()
        finally:
            for process in second.values():
                process.kill()
                process.wait()
            rig.processes = first
        complete(rig, client, scan)


def light_changes(rig: Rig) -> None:
    """F27: noticed within five frames, the sweep holds, the operator decides; frames since then are marked."""
    rig.at = 0.45 + 0.4 * rig.at
    changed_at = 5 + int(rig.at * (COUNT - 25))
    # exposure 0 is the ambient frame
    rig.set(SIMULATION__FAULTS=f"dim:{changed_at + 1}")
    rig.light.update({k: {"lamp": 0.7} for k in range(changed_at, COUNT)})
    rig.start("daemon", "writer")
    with rig.client() as client:
        scan = rig.begin(client)
        text = rig.told(client, "F27")
        held = rig.until_status(client, lambda s: s.state == "holding" and s.hold_reason == "paused", "it holds")
        assert changed_at < held.triggered <= changed_at + 6
        assert f"since frame {changed_at}" in text
        assert client.request("resume").ok
        complete(rig, client, scan)
    with ScanReader(Path(scan["path"])) as reader:
        assert f"light changed at frame {changed_at}" in str(reader.scalar("reason"))
        assert np.array_equal(reader.other_light(), np.arange(COUNT) >= changed_at), "other frames are marked"
    results = reconstruct(Path(scan["path"]), ReconstructOptions()).results.report
    assert results.sweep.light_changed_at == changed_at and results.counts["frames_other_light"] == COUNT - changed_at
    assert 0 < results.counts["quality_other_light"] <= results.counts["crossings"]
    assert any(f"light changed at frame {changed_at}" in warning for warning in results.warnings)


ROWS: dict[str, Row] = {
    "F01": daemon_killed,
    "F02": daemon_frozen,
    "F03": writer_killed,
    "F04": writer_frozen,
    "F05": writer_never_started,
    "F06": disk_full,
    "F07": disk_broken,
    "F08": worker_killed,
    "F09": worker_frozen,
    "F10": clients_come_and_go,
    "F16": frames_lost,
    "F17": frames_extra,
    "F18": camera_restarts,
    "F19": frames_of_another_shape,
    "F20": hostile_messages,
    "F21": calibration_unusable,
    "F22": clock_jumps,
    "F24": told_to_end,
    "F25": everything_killed,
    "F26": two_of_a_kind,
    "F27": light_changes,
}
