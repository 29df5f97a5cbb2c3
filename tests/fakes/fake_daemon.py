"""A daemon without a rig: answers commands, publishes a scripted status, and keeps a log of what it was asked.

In-process (``FakeDaemon``) for tests, or as a program: ``python -m tests.fakes.fake_daemon RUN_DIR``.
"""

from __future__ import annotations

import argparse
import signal
import threading
from pathlib import Path
from typing import Any, Self

import msgspec
import numpy as np
import zmq

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Sender, bind, receive
from acquire.contract.messaging.messages import Command, Picture, Reply, ResultEnd, ResultProgress, Status
from acquire.contract.plan import SweepPlan
from acquire.contract.states import HoldReason, Outcome, State
from tests.waiting import DEADLINE_S, wait_for

PLAN = SweepPlan(first_steps=0, last_steps=1578, steps_per_frame=3, um_per_microstep=3.175)
IDLE = Status(
    state=State.IDLE,
    position_steps=0,
    position_trusted=True,
    stage_kind="simulated",
    camera_kind="simulated",
    travel_steps=(0, 4500),
    writer_alive=True,
    message="ready: simulated stage, simulated camera",
)
SWEEPING = msgspec.structs.replace(
    IDLE,
    state=State.SWEEPING,
    scan_uid="uid-1",
    scan_path="/data/20260101T120000Z-stirrup",
    plan=PLAN,
    outcome=Outcome.RUNNING,
    position_steps=1236,
    position_um=1236 * 3.175,
    lamp_on=True,
    expected=527,
    triggered=413,
    received=412,
    committed=410,
    durable=384,
    credit=105,
    window=108,
    rate_hz=14.83,
    eta_s=7.9,
    elapsed_s=27.6,
    message="frame 412 taken",
)
PROGRESS = ResultProgress(
    version=3,
    folded_through=409,
    expected=527,
    over_contrast=76_000,
    points_settled=48_213,
    points_provisional=2_911,
    from_live=410,
    lag_frames=3,
)
"""A sweep's status and a worker's progress as they look in mid-sweep."""


class FakeDaemon:
    """Status, results and command lanes of a daemon whose every move is said by the test or by the commands."""

    def __init__(self, run_dir: Path, status: Status = IDLE, *, frames_per_tick: int = 2, expected: int = 400) -> None:
        self.run_dir = run_dir
        self.status = status
        self.progress: ResultProgress | None = None
        self.commands: list[tuple[str, dict[str, Any]]] = []
        self.sent_mono_ns: list[int] = []
        """The stamp of each command."""
        self.refuse: dict[str, str] = {}
        self.show_pictures = False
        """Publish a picture with every status: a bright disc that wanders over noise."""
        self._pictures_sent = 0
        self.deaf = False
        self.silent = False
        self.rubbish = b""
        """Sent before each status if not empty."""
        self._frames_per_tick, self._expected = frames_per_tick, expected
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._changed = threading.Condition(self._lock)
        self._thread = threading.Thread(target=self._run, name="fake-daemon", daemon=True)

    def __enter__(self) -> Self:
        self._context: zmq.Context[Any] = zmq.Context()
        self._status = Sender(bind(self._context, zmq.PUB, self.run_dir, "status"))
        self._results = Sender(bind(self._context, zmq.PUB, self.run_dir, "results"))
        self._commands = Sender(bind(self._context, zmq.ROUTER, self.run_dir, "command"))
        self._preview = Sender(bind(self._context, zmq.PUB, self.run_dir, "preview"))
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(5)
        self._context.destroy(linger=0)
        for lane in ("status", "results", "command", "preview"):
            (self.run_dir / f"{lane}.sock").unlink(missing_ok=True)

    def show(self, **changes: Any) -> None:
        """Change fields of the status that is published."""
        with self._lock:
            self.status = msgspec.structs.replace(self.status, **changes)

    def asked(self, name: str, count: int = 1, deadline_s: float = DEADLINE_S) -> dict[str, Any]:
        """Wait until command ``name`` has come ``count`` times; returns the last one's arguments."""

        def came() -> bool:
            with self._changed:
                return self._changed.wait_for(lambda: len(self._of(name)) >= count, 0.2)

        wait_for(came, f"{count} times the command {name}", deadline_s, why=lambda: self.commands)
        with self._lock:
            return self._of(name)[-1]

    def _of(self, name: str) -> list[dict[str, Any]]:
        return [args for asked, args in self.commands if asked == name]

    def _run(self) -> None:
        while not self._ending.is_set():
            if self._commands.socket.poll(50):
                self._serve()
            with self._lock:
                self._advance()
                if self.silent:
                    continue
                if self.rubbish:
                    self._status.socket.send(self.rubbish)
                self._status.send(self.status)
                if self.progress is not None:
                    self._results.send(self.progress)
                if self.show_pictures:
                    self._send_picture()

    def _send_picture(self) -> None:
        self._pictures_sent += 1
        header = Picture(
            shape=[192, 256], source_shape=[768, 1024], position_steps=3 * self._pictures_sent, exposure_ms=30.0,
            full_scale_share=0.02, low=9.0, high=255.0,
        )  # fmt: skip
        self._preview.send(header, wandering_disc(self._pictures_sent).tobytes())

    def _serve(self) -> None:
        try:
            received = receive(self._commands.socket)
        except ProtocolError:
            return
        if received is None or not isinstance(received.message, Command):
            return
        command = received.message
        with self._changed:
            self.commands.append((command.name, command.args))
            self.sent_mono_ns.append(command.sent_mono_ns)
            if not self.deaf:
                self._commands.send(self._do(command), routing_id=received.routing_id)
            self._changed.notify_all()

    def _do(self, command: Command) -> Reply:
        if command.name in self.refuse:
            return Reply(request_id=command.request_id, ok=False, error=self.refuse[command.name])
        act = getattr(self, f"_do_{command.name}", None)
        result = act(**command.args) if act else {}
        return Reply(request_id=command.request_id, ok=True, result=result or {})

    def _set(self, **changes: Any) -> None:
        self.status = msgspec.structs.replace(self.status, **changes)

    def _do_scan(self, name: str = "scan", **_: Any) -> dict[str, Any]:
        path, count = f"/data/20260101T120000Z-{name}", self._expected
        self._set(
            state=State.SWEEPING, outcome=Outcome.RUNNING, scan_uid=f"uid-{name}", scan_path=path, expected=count,
            triggered=0, received=0, committed=0, durable=0, missing=0, plan=PLAN, window=108, credit=108,
            message="frame 0 taken",
        )  # fmt: skip
        return {"scan_uid": f"uid-{name}", "path": path, "expected": count}

    def _do_pause(self) -> None:
        self._set(state=State.HOLDING, hold_reason=HoldReason.PAUSED, rate_hz=0.0, eta_s=None)

    def _do_resume(self) -> None:
        self._set(state=State.SWEEPING, hold_reason="")

    def _do_stop(self) -> None:
        if self.status.state in (State.SWEEPING, State.HOLDING):
            self._end(Outcome.STOPPED)

    def _end(self, outcome: Outcome) -> None:
        status = self.status
        self._set(
            state=State.IDLE, hold_reason="", outcome=outcome, durable=status.committed, rate_hz=0.0, eta_s=None,
            missing=status.expected - status.committed, message=f"the sweep ended: {outcome}",
        )  # fmt: skip
        self._results.send(ResultEnd(version=9, outcome=outcome, folded_through=status.committed - 1, points=51_124))

    def _advance(self) -> None:
        status = self.status
        if status.state != State.SWEEPING or not self._frames_per_tick or status.outcome != Outcome.RUNNING:
            return
        done = min(status.expected, status.committed + self._frames_per_tick)
        self._set(
            triggered=done, received=done, committed=done, durable=done // 64 * 64, position_steps=3 * done,
            rate_hz=20.0 * self._frames_per_tick, eta_s=(status.expected - done) / (20.0 * self._frames_per_tick),
            position_um=9.525 * done,
        )  # fmt: skip
        if done == status.expected:
            self._end(Outcome.COMPLETE)


def wandering_disc(number: int) -> np.ndarray:
    """[192, 256] uint8: noise with a bright disc whose place depends on ``number``; its middle is clipped."""
    y, x = np.mgrid[0:192, 0:256]
    distance = np.hypot(y - 96, x - (40 + 6 * number % 180))
    noise = np.random.default_rng(number).normal(60, 12, (192, 256))
    return np.clip(np.where(distance < 40, 330 - 4 * distance, noise), 0, 255).astype(np.uint8)


def main() -> None:
    """Run until SIGTERM or SIGINT."""
    parser = argparse.ArgumentParser()
    parser.add_argument("run_dir", type=Path)
    parser.add_argument("--expected", type=int, default=400)
    parser.add_argument("--frames-per-tick", type=int, default=2)
    arguments = parser.parse_args()
    ending = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: ending.set())
    with FakeDaemon(arguments.run_dir, frames_per_tick=arguments.frames_per_tick, expected=arguments.expected):
        ending.wait()


if __name__ == "__main__":
    main()
