"""Measures the console: key to effect, processor time, STOP on a stuck terminal, echoes on a slow one."""

from __future__ import annotations

import shutil
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
import zmq

from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.lanes import Sender, bind, receive
from acquire.contract.messaging.messages import Command, Picture, Reply, Status
from acquire.contract.process.run_dir import is_served
from acquire.contract.states import State
from tests.bench.terminal import BareLine, Tmux
from tui.client.follow import has_ended
from tui.client.rig_client import ProgressFeed, RigClient
from tui.console.state.jog import STEP_SIZES
from tui.demo.rig import DemoOptions, DemoRig

READY_S = 180.0
WATCH_S = 10.0
PRESSES = 30
STUCK_TRIES = 5
SLOW_BYTES_PER_S = 100_000.0


def bench_console(size: tuple[int, int]) -> dict[str, Any]:
    """Figures in ms, s and shares of one core; ``size`` in cells."""
    folder = Path(tempfile.mkdtemp(prefix="bench-console-"))
    try:
        with DemoRig(DemoOptions(data_dir=folder), lambda _text: None) as rig:
            figures = _with_rig(rig, size)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return figures | {"stop_stuck_ms": _stop_while_stuck(), "slow_link": _slow_link(size)}


# ---- a real sweep in tmux ----


def _with_rig(rig: DemoRig, size: tuple[int, int]) -> dict[str, Any]:
    with _client(rig) as client, Tmux(rig.run_dir, size) as terminal:
        terminal.wait_for("s start")
        client.request("scan", name="bench")
        terminal.wait_for("SWEEPING")
        terminal.wait_for(" px  ")
        figures: dict[str, Any] = {"cpu_share_of_a_core": _cpu_share(terminal)}
        figures["key_to_effect_ms"] = _summary(list(_echoes(terminal)))
        figures["pause_to_holding_ms"] = _summary(list(_round_trips(terminal)))
        client.request("stop")
        client.wait_for(lambda status: has_ended(status, status.scan_uid), READY_S)
        return figures


@contextmanager
def _client(rig: DemoRig) -> Iterator[RigClient]:
    feed = ProgressFeed(rig.run_dir)
    end_s = time.monotonic() + READY_S
    try:
        while not is_served(rig.run_dir) or feed.newest() is None:
            rig.check()
            if time.monotonic() > end_s:
                raise SweepscopeError(f"the services were not ready within {READY_S:g} s")
            time.sleep(0.1)
    finally:
        feed.close()
    with RigClient(rig.run_dir) as client:
        if client.wait_for(lambda status: status.state == State.IDLE and status.writer_alive, READY_S) is None:
            raise SweepscopeError(f"the writer was not ready within {READY_S:g} s")
        yield client


def _cpu_share(terminal: Tmux) -> float:
    begin_cpu_s, begin_s = terminal.cpu_s(), time.monotonic()
    time.sleep(WATCH_S)
    return (terminal.cpu_s() - begin_cpu_s) / (time.monotonic() - begin_s)


def _echoes(terminal: Tmux) -> Iterator[float]:
    """A key whose effect is local to the console: another step size."""
    sizes = STEP_SIZES[1:3]
    for number in range(PRESSES):
        wanted = sizes[(number + 1) % 2]
        yield terminal.effect_s("]" if wanted == sizes[1] else "[", f" . {wanted} [")


def _round_trips(terminal: Tmux) -> Iterator[float]:
    """A key that needs an answer of the daemon."""
    for _ in range(PRESSES // 6):
        yield terminal.effect_s("p", "HOLDING (paused)")
        terminal.effect_s("r", "SWEEPING")


# ---- a terminal of limited speed, with a stand-in for the daemon ----


class StandIn:
    """Publishes five statuses and pictures per second, and records when commands arrive. A context manager."""

    def __init__(self) -> None:
        self.run_dir = Path(tempfile.mkdtemp(prefix="bench-line-"))
        self.came_s: dict[str, float] = {}
        self.news = threading.Event()
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="stand-in", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(READY_S)
        shutil.rmtree(self.run_dir, ignore_errors=True)

    def _run(self) -> None:
        context: zmq.Context[Any] = zmq.Context()
        commands = Sender(bind(context, zmq.ROUTER, self.run_dir, "command"))
        status = Sender(bind(context, zmq.PUB, self.run_dir, "status"))
        preview = Sender(bind(context, zmq.PUB, self.run_dir, "preview"))
        number, next_s = 0, 0.0
        while not self._ending.is_set():
            if commands.socket.poll(20):
                self._take(commands)
            if time.monotonic() >= next_s:
                number, next_s = number + 1, time.monotonic() + 0.2
                status.send(
                    Status(state=State.PREVIEW, activity="preview", position_steps=number, position_trusted=True)
                )
                preview.send(_picture(number), _pixels(number))
        context.destroy(linger=0)

    def _take(self, commands: Sender) -> None:
        received = receive(commands.socket)
        if received is not None and isinstance(received.message, Command):
            self.came_s[received.message.name] = time.monotonic()
            self.news.set()
            reply = Reply(request_id=received.message.request_id, ok=True)
            commands.send(reply, routing_id=received.routing_id)

    def wait_for(self, name: str) -> float:
        """Time at which the command arrived.

        Raises:
            SweepscopeError: it did not.
        """
        end_s = time.monotonic() + READY_S
        while name not in self.came_s:
            if time.monotonic() > end_s:
                raise SweepscopeError(f"{name} never reached the stand-in for the daemon")
            self.news.clear()
            self.news.wait(0.05)
        return self.came_s.pop(name)


def _picture(number: int) -> Picture:
    return Picture(shape=[384, 512], source_shape=[768, 1024], position_steps=number, exposure_ms=30.0)


def _pixels(number: int) -> bytes:
    """A scene that moves as a whole: the most expensive to draw."""
    y, x = np.mgrid[0:384, 0:512]
    scene = 120 + 60 * np.sin((x + 17 * number) / 25) + 50 * np.sin((y + 11 * number) / 19)
    return np.clip(scene, 0, 255).astype(np.uint8).tobytes()


def _stop_while_stuck() -> dict[str, float]:
    times = []
    for _ in range(STUCK_TRIES):
        with StandIn() as daemon, BareLine(daemon.run_dir, (80, 24), 50e6) as line:
            line.effect_s("", " px  ")
            line.stick("][" * 100)
            begin_s = time.monotonic()
            line.type(" ")
            times.append(daemon.wait_for("stop") - begin_s)
    return _summary(times)


def _slow_link(size: tuple[int, int]) -> dict[str, Any]:
    with StandIn() as daemon, BareLine(daemon.run_dir, size, SLOW_BYTES_PER_S) as line:
        line.effect_s("", " px  ")
        time.sleep(WATCH_S)  # until the picture rate has settled
        begin_bytes, begin_s = line.read_bytes, time.monotonic()
        sizes = STEP_SIZES[1:3]
        echoes = []
        for number in range(PRESSES):
            wanted = sizes[(number + 1) % 2]
            echoes.append(line.effect_s("]" if wanted == sizes[1] else "[", f"{wanted} [ ]"))
            time.sleep(0.2)
        rate = (line.read_bytes - begin_bytes) / (time.monotonic() - begin_s)
        return {"link_bytes_per_s": SLOW_BYTES_PER_S, "used_bytes_per_s": rate, "key_to_effect_ms": _summary(echoes)}


def _summary(seconds: list[float]) -> dict[str, float]:
    ms = sorted(1000.0 * value for value in seconds)
    return {"median": statistics.median(ms), "worst": ms[-1], "count": float(len(ms))}
