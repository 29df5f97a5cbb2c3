"""A process that plays the daemon toward writer and worker: a synthetic sweep, with knobs for what can go wrong.

It speaks the frames, live and status lanes, and keeps a log of its own, synced to disk before a frame leaves it:
``frame_index trigger_id crc32`` a line. That log is the witness that the scan file is compared with.

    python -m tests.fakes.fake_camera --run-dir RUN --scan FOLDER --frames 100 --loss 0.01 --seed 3
"""

from __future__ import annotations

import argparse
import json
import os
import random
import time
from pathlib import Path
from typing import IO, Any

import msgspec
import numpy as np
import zmq

from acquire.contract.messaging.lanes import Sender, bind
from acquire.contract.messaging.messages import AckItem, End, EndAck, FrameFormat, Image, Nack, Status
from acquire.contract.process.run_dir import lock_service, prepare_run_dir
from acquire.contract.states import Outcome, State
from acquire.daemon.frame_sender import FrameSender
from acquire.sweep.credit_window import CreditWindow
from acquire.sweep.events import Committed, Refused, Sealed, WriterReady
from tests.fakes.scans.frames import image_of, pixels_of, start_of
from tests.waiting import Stopwatch

STATUS_S = 0.2


class FakeCamera:
    """One sweep from ``start`` to ``end_ack``."""

    def __init__(self, options: argparse.Namespace, context: zmq.Context[Any]) -> None:
        self.options = options
        self.random = random.Random(options.seed)
        self.start = start_of(options.scan, options.frames, options.format, scan_uid=options.uid)
        self.lane = FrameSender(bind(context, zmq.ROUTER, options.run_dir, "frames"))
        self.window = CreditWindow(options.slots)
        self.live = Sender(bind(context, zmq.PUB, options.run_dir, "live"), epoch=self.lane.sender.epoch)
        self.status = Sender(bind(context, zmq.PUB, options.run_dir, "status"), epoch=self.lane.sender.epoch)
        self.witness: IO[str] | None = options.witness.open("a") if options.witness else None
        self.acks: IO[str] | None = options.acks.open("a", buffering=1) if options.acks else None
        self.counters = {"live_lost": 0, "duplicates": 0, "bad": 0, "conflicts": 0, "came_back": 0, "readies": 0}
        self.nacks: dict[str, int] = {}
        self.durable = 0
        self.end_ack: EndAck | None = None
        self._noted: set[int] = set()
        self._watch = Stopwatch()
        self._next_status = 0.0

    def run(self) -> dict[str, Any]:
        """Send the whole sweep; what came of it."""
        self.lane.begin(self.start)
        self._until(lambda: self.lane.ready, "a writer")
        self.live.send(self.start)
        for frame_index in range(self.options.frames):
            self._until(lambda wanted=frame_index: self.window.may_trigger_through() >= wanted, "credit")
            self._shoot(frame_index)
            self._pause(self.options.delay_ms / 1000)
        self._until(lambda: not self.lane.unacked, "all acks")
        end = self._end_message()
        self.lane.finish(end)
        self._until(lambda: self.end_ack is not None, "the end's ack")
        self.live.send(end)
        return self._summary()

    def stay(self) -> None:
        """Go on telling the status until the process is ended, as a daemon does: the live lane may lose the end."""
        while True:
            self._pause(STATUS_S)

    def _end_message(self) -> End:
        options = self.options
        return End(
            scan_uid=options.uid,
            outcome=Outcome(options.outcome),
            expected=options.frames,
            sent=options.frames,
            counters=self.lane.counters,
        )

    def _shoot(self, frame_index: int) -> None:
        pixels = pixels_of(frame_index, self.options.frames, self.options.format, self.options.seed)
        image = image_of(frame_index, pixels, self.start)
        if self.witness is not None:
            self.witness.write(f"{frame_index} {image.trigger_id} {image.crc32}\n")
            self.witness.flush()
            os.fdatasync(self.witness.fileno())
        if self._chance(self.options.bad):
            self._send_bad(image, pixels)
        self.window.publish(image)
        self.lane.offer(image, pixels)
        if self._chance(self.options.duplicate):
            self.counters["duplicates"] += 1
            self._send_beside(image, pixels)
        if self._chance(self.options.conflict):
            self.counters["conflicts"] += 1
            other = np.invert(pixels)
            self._send_beside(image_of(frame_index, other, self.start, attempt=1), other)
        if self._chance(self.options.loss):
            self.counters["live_lost"] += 1
        else:
            self.live.send(image, pixels)

    def _send_bad(self, image: Image, pixels: Any) -> None:
        """A frame with a wrong checksum, shape, type or length ahead of the right one."""
        self.counters["bad"] += 1
        other_type = "<u2" if image.dtype == "|u1" else "|u1"
        changes: dict[str, Any] = self.random.choice(
            [{"crc32": image.crc32 ^ 1}, {"shape": [7, *image.shape[1:]]}, {"dtype": other_type}, {}]
        )
        payload = pixels if changes else pixels[:-1]
        self._send_beside(msgspec.structs.replace(image, **changes), payload)

    def _send_beside(self, image: Image, pixels: Any) -> None:
        """Send without the window knowing, to the writer that is there."""
        writer = self.lane._writer
        if writer is not None:
            self.lane.sender.send(image, pixels, routing_id=writer.routing_id)

    def _chance(self, probability: float) -> bool:
        return self.random.random() < probability

    def _until(self, fact: Any, what: str) -> None:
        while not fact():
            if self._watch.elapsed_s > self.options.deadline_s:
                raise SystemExit(f"fake camera: {what}: not within {self.options.deadline_s:g} s")
            self.lane.socket.poll(20)
            self._poll()

    def _pause(self, duration_s: float) -> None:
        end = time.monotonic() + duration_s
        self._poll()
        while (rest := end - time.monotonic()) > 0:
            self.lane.socket.poll(max(1, int(rest * 1000)))
            self._poll()

    def _poll(self) -> None:
        for event in self.lane.poll(time.monotonic_ns()):
            if isinstance(event, Committed):
                self.durable = event.durable_count
                self._note(event.frames)
            elif isinstance(event, Refused):
                self._refused(event.nack)
            elif isinstance(event, Sealed):
                self.end_ack = event.end_ack
            elif isinstance(event, WriterReady):
                self._note(event.committed)
                self.counters["readies"] += 1
                self.counters["came_back"] += event.came_back
        if time.monotonic() >= self._next_status:
            self._next_status = time.monotonic() + STATUS_S
            self.status.send(self._status())

    def _note(self, items: tuple[AckItem, ...]) -> None:
        """Frames that are acked, or found in the file by a writer that came back after one that died before its ack."""
        news = [item.frame_index for item in items if item.frame_index not in self._noted]
        self._noted.update(news)
        self.window.commit(items)
        if self.acks is not None:
            now_ns = time.monotonic_ns()
            self.acks.write("".join(f"{frame_index} {now_ns}\n" for frame_index in news))

    def _refused(self, nack: Nack) -> None:
        self.nacks[nack.reason] = self.nacks.get(nack.reason, 0) + 1

    def _status(self) -> Status:
        running = self.end_ack is None
        return Status(
            scan_uid=self.options.uid,
            state=State.SWEEPING if running else State.IDLE,
            scan_path=str(self.options.scan),
            plan=self.start.plan,
            format=self.options.format,
            outcome=Outcome.RUNNING if self.end_ack is None else self.end_ack.outcome,
            expected=self.options.frames,
            committed=len(self.window.committed),
            durable=self.durable,
        )

    def _summary(self) -> dict[str, Any]:
        return {
            "end_ack": msgspec.to_builtins(self.end_ack),
            "counters": {**self.lane.counters, **self.counters},
            "nacks": self.nacks,
            "durable": self.durable,
            "kept_bytes": sum(frame.pixels.nbytes for frame in self.lane.unacked.values()),
        }


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run-dir", type=Path, required=True)
    parser.add_argument("--scan", type=Path, required=True, help="folder of the scan")
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--height", type=int, default=48)
    parser.add_argument("--bit-depth", type=int, default=8)
    parser.add_argument("--pixel-format", default="mono")
    parser.add_argument("--uid", default="fake-1")
    parser.add_argument("--outcome", default="complete")
    parser.add_argument("--slots", type=int, default=16, help="frames that may be uncommitted at a time")
    parser.add_argument("--loss", type=float, default=0.0, help="share of frames lost on the live lane")
    parser.add_argument("--delay-ms", type=float, default=0.0, help="rest after each frame")
    parser.add_argument("--duplicate", type=float, default=0.0, help="share of frames sent twice")
    parser.add_argument("--conflict", type=float, default=0.0, help="share of frames sent again with other pixels")
    parser.add_argument("--bad", type=float, default=0.0, help="share of frames preceded by a damaged one")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--deadline-s", type=float, default=60.0)
    parser.add_argument("--stay", type=int, default=0, help="1: go on telling the status after the end")
    parser.add_argument("--witness", type=Path, help="log of every frame, synced before it is sent")
    parser.add_argument("--acks", type=Path, help="log of every ack: frame_index and CLOCK_MONOTONIC in ns")
    options = parser.parse_args()
    options.format = FrameFormat(options.width, options.height, options.bit_depth, options.pixel_format)
    return options


def main() -> None:
    """Play one sweep; prints a JSON object with what came of it."""
    options = _options()
    lock = lock_service(prepare_run_dir(options.run_dir), "daemon")
    context: zmq.Context[Any] = zmq.Context()
    try:
        camera = FakeCamera(options, context)
        print(json.dumps(camera.run()), flush=True)
        if options.stay:
            camera.stay()
    finally:
        context.destroy(linger=1000)
        lock.release()


if __name__ == "__main__":
    main()
