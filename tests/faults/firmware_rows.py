"""The rows of the serial line and the controller, through the whole system: real services over the emulated firmware.

The pins are one more witness: the bench's own record of where the stage truly was at each trigger.
"""

from __future__ import annotations

import json
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.contract.scan_data.dataset_names import PINS_NAME
from acquire.contract.scan_data.reader import ScanReader
from tests.needs import EMULATOR, need
from tests.waiting import WALL_CLOCK_S
from tui.client.rig_client import RigClient

from .harness import EXPOSED_SHARE, START_S, STEPS, Rig, assert_promise
from .rows import complete, outcome_in_file, resume

LEASE_MS = 300.0
PACE = 4.0
"""Seconds of the controller in one of the host."""
RATE_HZ = 15.0
"""Triggers in one second of the controller."""
CPU_HZ = 16_000_000
CLOCK_CYCLES = 16
OVERFLOW_CYCLES = 65536 * 8
HALT_S = 0.3
"""Time of the controller that it takes to notice and to come to rest."""
EMULATED = {
    "STAGE__KIND": "uno",
    "STAGE__PORT": "emulator",
    "STAGE__ACCELERATION_STEPS_PER_S2": 100_000.0,
    "STAGE__SETTLE_MS": 2.0,
    "STAGE__MOTION_LEASE_MS": LEASE_MS,
    "SIMULATION__TIME_SCALE": 1 / PACE,
    "SWEEP__MAX_RATE_HZ": RATE_HZ,
    "SWEEP__CHECK_LIMIT": "true",
}
"""60 frames per second, where the machine is fast enough for it."""


class Bench:
    """A second hand at the emulator's knobs: the first one is the daemon's."""

    def __init__(self, control: Path) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(WALL_CLOCK_S)
        self._socket.connect(str(control))
        self._lines = self._socket.makefile("r", encoding="ascii")

    def knob(self, text: str) -> str:
        """Turn a knob."""
        self._socket.sendall(text.encode() + b"\n")
        answer = self._lines.readline()
        assert answer.startswith("ok"), f"{text}: {answer}"
        return answer[3:].strip()

    def pin(self, name: str) -> int:
        """One of the counts and levels that the bench has seen at the pins."""
        return int(dict(word.split("=", 1) for word in self.knob("state").split())[name])

    def close(self) -> None:
        """Let go of the knobs."""
        self._lines.close()
        self._socket.close()


def set_up(rig: Rig) -> None:
    """Services that are started from now on run over the emulated controller."""
    need(*EMULATOR)
    places = rig.data_dir.parent / "tmp"
    places.mkdir(parents=True, exist_ok=True)
    rig.environ["TMPDIR"] = str(places)
    rig.set(**EMULATED)


@contextmanager
def _emulated(rig: Rig) -> Iterator[tuple[RigClient, Bench]]:
    """Daemon and writer over an emulated controller that was homed."""
    set_up(rig)
    rig.start("daemon", "writer")
    with rig.client() as client:
        (control,) = rig.until(
            lambda: list((rig.data_dir.parent / "tmp").glob("stage-*/control")), "the emulator", START_S
        )
        bench = Bench(control)
        try:
            home(rig, client)
            yield client, bench
        finally:
            bench.close()


def home(rig: Rig, client: RigClient) -> None:
    """Find the zero, and wait until it is found."""
    client.request("home")
    _until_homed(rig, client)


def _until_homed(rig: Rig, client: RigClient) -> None:
    rig.until_status(client, lambda s: s.state == "idle" and s.position_trusted, "the stage is homed")


def _offset(rig: Rig, client: RigClient, bench: Bench) -> int:
    """Where the firmware's zero truly is; a step lost or doubled moves it."""
    status = rig.until_status(client, lambda s: s.state == "idle", "the stage rests")
    return bench.pin("position") - status.position_steps


def assert_pins(folder: Path, without: frozenset[int] = frozenset()) -> frozenset[int]:
    """Each frame's trigger was fired where the frame says it was; returns the frames that are there.

    ``without`` are frames from before a restart of the controller, which counts its triggers anew.
    """
    pairs = [json.loads(line) for line in (folder / PINS_NAME).read_text().splitlines()]
    true = {pair["trigger_id"]: pair["true_steps"] for pair in pairs if pair["delivered"]}
    with ScanReader(folder) as reader:
        triggers, present = reader.field("trigger_id"), frozenset(map(int, np.flatnonzero(reader.present())))
    for k in present - without:
        place = true[int(triggers[k])]
        assert place == STEPS * k, f"frame {k} was taken at {place}"
    # one clock, one offset; edges are seen between two instructions, and simavr 1.6 may drop an overflow now and then
    apart = [pair["true_cycles"] - pair["counted_cycles"] for pair in pairs]
    spread = [(value - apart[0] + OVERFLOW_CYCLES // 2) % OVERFLOW_CYCLES for value in apart]
    off = max(spread, default=0) - min(spread, default=0)
    assert off <= CLOCK_CYCLES, f"times of triggers are off by {off} cycles"
    return present


def noise_on_the_line(rig: Rig) -> None:
    """F11: every block that noise hurts is sent again; no step is lost or doubled."""
    with _emulated(rig) as (client, bench):
        offset = _offset(rig, client, bench)
        bench.knob(f"seed {rig.seed}")
        scan = rig.begin(client)
        rig.at *= 0.3
        rig.moment(client)
        bench.knob("noise 0.004")
        complete(rig, client, scan)
        bench.knob("noise 0")
        assert_pins(Path(scan["path"]))
        assert _offset(rig, client, bench) == offset, "steps were lost or doubled"
        assert bench.pin("hurt") > 50
        assert "resent" in rig.seen[scan["scan_uid"]].faults["F11"]


def cable_pulled(rig: Rig) -> None:
    """F12: the stage holds, the operator is told, and the sweep goes on when the cable is back."""
    with _emulated(rig) as (client, bench):
        offset = _offset(rig, client, bench)
        scan = rig.begin(client)
        rig.moment(client)
        bench.knob("unplug")
        assert "plug it in" in rig.told(client, "F12")
        held = rig.until_status(client, lambda s: s.state == "holding", "it holds")
        assert held.hold_reason == "link lost" and not held.position_trusted
        bench.knob("plug")
        status = complete(rig, client, scan)
        assert status.position_trusted
        assert_pins(Path(scan["path"]))
        assert _offset(rig, client, bench) == offset, "steps were lost or doubled"


def controller_reset(rig: Rig) -> None:
    """F13: position untrusted; interrupted with its reason; after homing it is resumed and complete."""
    with _emulated(rig) as (client, bench):
        scan = rig.begin(client)
        rig.moment(client)
        bench.knob(f"reset {rig.random.choice(['external', 'brownout', 'watchdog'])}")
        assert "home" in rig.told(client, "F13")
        status = rig.finished(client, scan["scan_uid"])
        before = assert_pins(Path(scan["path"]))
        assert_promise(Path(scan["path"]), rig, "interrupted")
        assert status.outcome == "interrupted" and not status.position_trusted
        with ScanReader(Path(scan["path"])) as reader:
            assert "F13" in str(reader.scalar("reason"))
        client.request("acknowledge")
        home(rig, client)
        resume(rig, client, scan)
        complete(rig, client, scan)
        assert_pins(Path(scan["path"]), before)


def other_firmware(rig: Rig) -> None:
    """F14: refused at the handshake with both versions named; the service leaves, nothing has moved."""
    set_up(rig)
    rig.environ["SWEEPSCOPE_TEST_INJECT"] = "other firmware"
    rig.start("daemon")
    process = rig.processes["daemon"]
    command = rig.run_dir / "command.sock"
    rig.until(lambda: process.poll() is not None or command.exists(), "the daemon has decided", START_S)
    log = rig.log.read_text()
    assert process.poll() == 1, f"the daemon took it: {log}"
    assert "9.0" in log and "1.0" in log and "nothing has moved" in log


def _let_pass(rig: Rig, bench: Bench, duration_s: float) -> None:
    """Wait until so much time has passed for the controller, which may be slower than it should be."""
    end = bench.pin("cycles") + round(duration_s * CPU_HZ)
    rig.until(lambda: bench.pin("cycles") >= end, f"{duration_s} s pass for the controller")


def host_late(rig: Rig) -> None:
    """F15: the controller does not hear the host: it holds within its lease, at a known place, and goes on with it."""
    with _emulated(rig) as (client, bench):
        offset = _offset(rig, client, bench)
        rig.light.on_the_fly = EXPOSED_SHARE
        scan = rig.begin(client, mode="fly")
        rig.at *= 0.5
        rig.moment(client)
        rig.send_signal("daemon", signal.SIGSTOP)
        try:
            fired = bench.pin("triggers")
            _let_pass(rig, bench, PACE * LEASE_MS / 1000 + HALT_S)
            at_rest = bench.pin("triggers"), bench.pin("position")
            _let_pass(rig, bench, 2.0)
            assert (bench.pin("triggers"), bench.pin("position")) == at_rest, "it moves without a host"
            # the controller's memory of triggers would stop it as well, but only after 32
            assert at_rest[0] - fired <= RATE_HZ * (PACE * LEASE_MS / 1000 + HALT_S)
        finally:
            rig.send_signal("daemon", signal.SIGCONT)
        complete(rig, client, scan)
        assert_pins(Path(scan["path"]))
        assert _offset(rig, client, bench) == offset, "steps were lost or doubled"
        assert "load" in rig.seen[scan["scan_uid"]].faults["F15"]


def switches(rig: Rig) -> None:
    """F23: limit switch or emergency stop: the firmware stops by itself; aborted; nothing moves until it is cleared."""
    with _emulated(rig) as (client, bench):
        scan = rig.begin(client)
        rig.moment(client)
        # moving away from the limit switch nobody minds it: its alarm comes on the way back
        estop = rig.at < 0.5
        bench.knob("estop 1" if estop else "limit press")
        assert "clear it" in rig.told(client, "F23")
        status = rig.finished(client, scan["scan_uid"])
        steps = bench.pin("steps")
        assert_promise(Path(scan["path"]), rig, "aborted")
        assert_pins(Path(scan["path"]))
        assert status.outcome == "aborted" and not status.position_trusted
        with ScanReader(Path(scan["path"])) as reader:
            assert "F23" in str(reader.scalar("reason"))
        assert bench.pin("steps") == steps, "it moves after an alarm"
        bench.knob("estop 0" if estop else "limit auto")
        client.request("acknowledge")
        rig.until(lambda: _may_home(client), "the switch is heard to be free")
        _until_homed(rig, client)


def _may_home(client: RigClient) -> bool:
    with suppress(CommandRefusedError):
        client.request("home")
        return True
    return False


def daemon_killed_over_the_controller(rig: Rig) -> None:
    """F01 with the controller's eyes: it ends with the daemon, is homed anew, and the scan goes on where it was."""
    with _emulated(rig) as (client, _bench):
        scan = rig.begin(client)
        rig.moment(client)
        rig.kill("daemon")
    rig.until(lambda: outcome_in_file(scan) == "interrupted", "the scan is marked as interrupted")
    before = assert_pins(Path(scan["path"]))
    assert_promise(Path(scan["path"]), rig, "interrupted")
    rig.start("daemon")
    with rig.client() as client:
        with pytest.raises(CommandRefusedError, match="home it first"):
            client.request("resume_scan", path=scan["path"])
        home(rig, client)
        resume(rig, client, scan)
        complete(rig, client, scan)
    assert_pins(Path(scan["path"]), before)


FIRMWARE_ROWS = {
    "F11": noise_on_the_line,
    "F12": cable_pulled,
    "F13": controller_reset,
    "F14": other_firmware,
    "F15": host_late,
    "F23": switches,
}
