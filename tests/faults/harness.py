"""One harness for every fault: real services, a fault at a chosen moment, and the promise checked against witnesses.

The witnesses are independent of what they judge: what each frame must show is rendered here from the position alone,
and what was acked is what the status lane told while the sweep ran, noted by this process.
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from acquire.contract.config.load import load_config
from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import is_served
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.dataset_names import FrameStatus
from acquire.contract.scan_data.reader import ScanReader
from acquire.simulation import Renderer, build_scene
from tests import ROOT
from tests.system.appliance import SMALL, Appliance
from tests.waiting import DEADLINE_S
from tui.client.rig_client import RigClient

STEPS = 12
COUNT = 1578 // STEPS + 1
FRAME_BYTES = 128 * 96 * 3
UM_PER_MICROSTEP = 3.175
START_S = 90.0
"""Longest wait for services to start on a machine that does other things as well."""
PACED = {"SIMULATION__TIME_SCALE": 0.1, "SWEEP__MAX_RATE_HZ": 15.0}
"""150 frames per second: a sweep of a second, so that a fault finds it running."""
EXPOSED_SHARE = 30.0 * float(PACED["SWEEP__MAX_RATE_HZ"]) / 1000.0
"""Share of a period during which the shutter is open, with the camera's default of 30 ms."""


class Light(dict[int, dict[str, float]]):
    """What was otherwise with the light of a frame, by its index, and whether the stage moved below the shutter."""

    on_the_fly = 0.0
    """Share of a frame's way during which the shutter is open; 0: the stage stands."""

    def of(self, frame_index: int) -> dict[str, float]:
        """What :func:`expected` must know of a frame."""
        return {"on_the_fly": self.on_the_fly} | self.get(frame_index, {})


@dataclass
class Seen:
    """What the status lane told of one scan: the tap of acks."""

    committed: int = 0
    """The most frames that were ever called committed."""
    said_saved: bool = False
    faults: dict[str, str] = field(default_factory=dict)
    last: Status | None = None

    def take(self, status: Status) -> None:
        """Note a status."""
        self.committed = max(self.committed, status.committed)
        self.said_saved |= "SAVED" in status.message
        self.faults |= {fault.code: f"{fault.happened}: {fault.safe}; {fault.to_do}" for fault in status.faults}
        self.last = status


class Rig(Appliance):
    """The services under test, a client's view of them, and the moment at which the fault comes."""

    def __init__(self, run_dir: Path, data_dir: Path, seed: int, at: float, sabotage: str = "") -> None:
        super().__init__(run_dir, data_dir, **PACED)
        self.random, self.at, self.sabotage, self.seed = random.Random(seed), at, sabotage, seed
        self.deadline_s = 20.0 if sabotage else DEADLINE_S
        self.seen: dict[str, Seen] = {}
        self.light = Light()
        self.flag = data_dir.parent / "flag"
        """A file whose existence switches an injected fault on."""
        self.environ["SWEEPSCOPE_TEST_FLAG"] = str(self.flag)
        self.prefix: list[str] = []
        """Command that services are started with: another place to live in."""

    @property
    def flies(self) -> bool:
        """The stage does not stop for a frame: those under way when one is lost may be lost with it, or one twice."""
        return self.light.on_the_fly > 0

    def fly(self) -> None:
        """Sweeps of services started from now on are on the fly."""
        self.set(SWEEP__MODE="fly")
        self.light.on_the_fly = EXPOSED_SHARE

    def set(self, **settings: Any) -> None:
        """Settings for services started from now on: SECTION__KEY=value."""
        self.environ |= {f"SWEEPSCOPE_{name}": str(value) for name, value in settings.items()}

    def start(self, *services: str) -> None:
        """Start services, sabotaged where this run is."""
        environ = {**self.environ, "SWEEPSCOPE_TEST_SABOTAGE": self.sabotage}
        for service in services:
            with self.log.open("ab") as log:
                self.processes[service] = subprocess.Popen(
                    [*self.prefix, sys.executable, "-m", "tests.faults.launch", service],
                    env=environ, cwd=ROOT, stdout=log, stderr=log,
                )  # fmt: skip

    def until(self, condition: Callable[[], Any], what: str, deadline_s: float | None = None) -> Any:
        """As the base, with this run's deadline."""
        return super().until(condition, what, deadline_s or self.deadline_s)

    def until_status(self, client: RigClient, wanted: Callable[[Status], Any], what: str) -> Status:
        """As the base, and everything that is heard is noted."""

        def noted(status: Status) -> Any:
            if status.scan_uid:
                self.seen.setdefault(status.scan_uid, Seen()).take(status)
            return wanted(status)

        return super().until_status(client, noted, what)

    def client(self) -> RigClient:
        """As the base; a service that only takes its time to start has not noticed anything."""
        self.until(lambda: is_served(self.run_dir), "the daemon binds", START_S)
        return RigClient(self.run_dir, timeout_s=self.deadline_s)

    def ready(self, client: RigClient) -> None:
        """Wait until a sweep can begin."""
        patience_s, self.deadline_s = self.deadline_s, max(self.deadline_s, START_S)
        self.until_status(client, lambda s: s.state == "idle" and s.writer_alive, "the rig is ready")
        self.deadline_s = patience_s

    def begin(self, client: RigClient, **args: Any) -> dict[str, Any]:
        """Start a sweep as soon as a writer is there."""
        self.ready(client)
        return self.scan(client, **args)

    def moment(self, client: RigClient) -> Status:
        """Wait for the fault's moment: a share of the sweep and a bit of a frame more."""
        wanted = 1 + int(self.at * (COUNT - 20))
        status = self.until_status(client, lambda s: s.committed >= wanted, f"{wanted} frames are committed")
        self.pause(self.random.random() * 0.015)
        return status

    def pause(self, duration_s: float) -> None:
        """Let time pass on purpose: where the fault itself is a duration."""
        end = time.monotonic() + duration_s
        while time.monotonic() < end:
            time.sleep(0.002)

    def told(self, client: RigClient, code: str) -> str:
        """Wait until the operator is told of a fault; returns the text."""
        self.until_status(client, lambda s: any(f.code == code for f in s.faults), f"the operator is told of {code}")
        return next(seen.faults[code] for seen in self.seen.values() if code in seen.faults)

    def freeze(self, service: str, duration_s: float) -> None:
        """SIGSTOP, and SIGCONT after a while."""
        self.send_signal(service, signal.SIGSTOP)
        self.pause(duration_s)
        self.send_signal(service, signal.SIGCONT)

    def rss(self, service: str) -> int:
        """Resident memory of a service in bytes."""
        return int(psutil.Process(self.processes[service].pid).memory_info().rss)

    def close(self) -> None:
        """Kill whatever still runs, frozen or not."""
        self.flag.unlink(missing_ok=True)
        super().close()


@contextmanager
def a_rig(seed: int, at: float, sabotage: str = "") -> Iterator[Rig]:
    """Folders of its own for one run, gone afterwards with every process."""
    with tempfile.TemporaryDirectory(prefix="ss-") as run, tempfile.TemporaryDirectory(prefix="ss-data-") as data:
        rig = Rig(Path(run), Path(data) / "scans", seed, at, sabotage)
        try:
            yield rig
        finally:
            rig.close()


def run_scan(fault: str, at: float, seed: int, sabotage: str = "", mode: str = "step") -> None:
    """One run of one row of the table: inject the fault, check the promise; raises where it does not hold.

    Args:
        fault: F01..F27.
        at: share of the sweep after which the fault comes, 0..1.
        seed: of everything that is random.
        sabotage: a protection that is switched off (``sabotage.PROTECTIONS``); the row must then fail.
        mode: ``step`` or ``fly``.
    """
    from .firmware_rows import FIRMWARE_ROWS
    from .rows import ROWS

    print(f"{fault} at={at:.3f} seed={seed} {mode} {sabotage}", flush=True)
    with a_rig(seed, at, sabotage) as rig:
        if mode == "fly":
            rig.fly()
        (ROWS | FIRMWARE_ROWS)[fault](rig)


@lru_cache(maxsize=1)
def _renderer() -> tuple[Any, Any]:
    rig = load_config(environ={f"SWEEPSCOPE_{k}": str(v) for k, v in SMALL.items()}).rig
    scene = build_scene(rig.simulation, width=128, height=96, um_per_microstep=rig.stage.um_per_microstep)
    return Renderer(scene), rig.camera


@lru_cache(maxsize=4 * COUNT)
def expected(frame_index: int, lamp: float = 1.0, room: float = 1.0, on_the_fly: float = 0.0) -> Any:
    """What the optics show in a frame: rendered by nothing that the services had a hand in.

    ``on_the_fly`` is the share of a frame's way during which the shutter is open; 0: the stage stands.
    """
    renderer, camera = _renderer()
    # by way of um, as the position travels through the system: the last bit counts
    middle = (STEPS * frame_index + STEPS * on_the_fly / 2) * UM_PER_MICROSTEP / UM_PER_MICROSTEP
    return renderer.render(
        middle, lamp=lamp, room=room, travel_steps=2 * (middle - STEPS * frame_index),
        exposure_ms=camera.exposure_ms, gain=camera.gain, brightness=camera.brightness_percent,
    )  # fmt: skip


def assert_frames(folder: Path, light: Light) -> int:
    """Whatever the file calls committed is there, bit for bit, at its place; returns how many frames that are."""
    with ScanReader(folder) as reader:
        status, positions, present = reader.status(), reader.field("position_steps"), reader.present()
        assert np.isin(status, list(FrameStatus)).all()
        for k in (int(index) for index in np.flatnonzero(present)):
            assert positions[k] == STEPS * k, f"frame {k} was taken at {positions[k]}"
            wanted = expected(k, **light.of(k))
            assert np.array_equal(reader.frame(k), wanted), f"frame {k} is another one than the rig showed"
            assert frame_crc32(reader.frame(k)) == reader.field("crc32")[k]
        return int(present.sum())


def assert_promise(folder: Path, rig: Rig, outcome: str) -> None:
    """P0: data first, then the state, then the operator's message, then the counters.

    Args:
        folder: the scan's.
        rig: with what it was told of the scan.
        outcome: how the scan must have ended.
    """
    there = assert_frames(folder, rig.light)
    with ScanReader(folder) as reader:
        seen = rig.seen.get(reader.layout.scan_uid, Seen())
        assert there >= seen.committed, f"{seen.committed} frames were acked, {there} are in the file"
        assert reader.outcome == outcome, f"the file says {reader.outcome}, not {outcome}"
        sealed = reader.layout.path.name == "scan.h5"
        assert sealed == (outcome != "interrupted")
        if sealed:
            assert reader.scalar("frames_committed") == there
            assert reader.scalar("digest") == _digest(reader.present(), rig.light)
        if outcome == "complete":
            assert there == COUNT
    if seen.said_saved:
        assert outcome == "complete" and there == COUNT, "it was called SAVED and is not"
    status = seen.last
    if status is not None and status.outcome == outcome and status.state == "idle":
        assert status.missing == COUNT - there, f"{status.missing} are said to be missing, {COUNT - there} are"
        assert status.committed == there


def _digest(present: Any, light: Light) -> str:
    crc32 = np.zeros(COUNT, np.uint32)
    for k in (int(index) for index in np.flatnonzero(present)):
        crc32[k] = frame_crc32(expected(k, **light.of(k)))
    return scan_digest(crc32)


def environment_of(rig: Rig) -> dict[str, str]:
    """For a command of the rig's own command line."""
    return {**os.environ, **rig.environ}
