"""Plays daemon and writer toward a worker, frame by frame as a test says: what goes live, what is committed, when."""

from __future__ import annotations

import json
import math
import subprocess
import sys
import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import zmq
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Sender, bind, connect, open_socket, receive
from acquire.contract.messaging.messages import (
    End,
    FrameFormat,
    Image,
    Message,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    ResultTiles,
    Start,
    Status,
)
from acquire.contract.plan import SweepPlan
from acquire.contract.process.run_dir import endpoint
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.writer.scan_file import ScanFile, create_scan
from tests.waiting import output_of, wait_for

_WORKER = (
    "import logging, sys; from pathlib import Path; logging.basicConfig(level='INFO');"
    "from acquire.contract.config.load import load_config; from process.worker.service import run_worker;"
    "run_worker(load_config(), Path(sys.argv[1]))"
)


def calibration_json(width: int, height: int) -> str:
    """A camera 77 mm above the stage, looking down, and a light plane that sweeps the field in x."""
    focal = 11500.0 * width / 1024
    return json.dumps(
        {
            "format": "sweepscope-calibration",
            "version": 1,
            "camera": {
                "width": width,
                "height": height,
                "K": [[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]],
                "distortion": [-0.3, 0, 0, 0, 0],
                "R": [[1, 0, 0], [0, -1, 0], [0, 0, -1]],
                "T": [0, 0, 77],
            },
            "light_plane": {
                "kind": "translating",
                "parameter": "position_um",
                "normal": [-0.546, -0.0055, 0.838],
                "corner_origin_mm": [3.0, 0, 0],
                "corner_velocity_mm": [-0.001, 0, 0],
                "velocity_direction": "assumed-axis",
            },
        }
    )


def edge_frames(count: int, width: int, height: int, *, colour: bool = False, seed: int = 1) -> list[NDArray[np.uint8]]:
    """A soft bright edge that crosses the image from left to right, with noise: [h, w] or [h, w, 3] RGB."""
    rng = np.random.default_rng(seed)
    where = np.linspace(0.1, 0.8, width)[None, :] * count + np.linspace(0, 3, height)[:, None]
    erf = np.vectorize(math.erf)(np.linspace(-4, 4, 801))
    frames = []
    for index in range(count):
        level = 20 + 80 * (1 + np.interp((index - where) / 2.0, np.linspace(-4, 4, 801), erf))
        noisy = np.clip(np.rint(level + rng.normal(0, 2, level.shape)), 0, 255)
        tinted = noisy[:, :, None] * np.array([1.0, 0.9, 0.7]) if colour else noisy
        frames.append(tinted.astype(np.uint8))
    return frames


@dataclass
class Heard:
    """What a subscriber of the results lane has heard."""

    progress: list[ResultProgress]
    tiles: list[tuple[ResultTiles, bytes]]
    ends: list[ResultEnd]
    maps: list[tuple[ResultMaps, bytes]] = field(default_factory=list)


class Listener:
    """A viewer's ear: subscribes to the results lane."""

    def __init__(self, context: zmq.Context[Any], run_dir: Path) -> None:
        self._socket = connect(context, zmq.SUB, run_dir, "results")
        self.heard = Heard([], [], [])

    def poll(self) -> Heard:
        """Take what is there."""
        while True:
            try:
                received = receive(self._socket)
            except ProtocolError as error:
                raise AssertionError(f"the worker sent what cannot be read: {error}") from error
            if received is None:
                return self.heard
            self._keep(received.message, received.payload.bytes if received.payload is not None else b"")

    def _keep(self, message: Message, payload: bytes) -> None:
        if isinstance(message, ResultProgress):
            self.heard.progress.append(message)
        elif isinstance(message, ResultTiles):
            self.heard.tiles.append((message, payload))
        elif isinstance(message, ResultMaps):
            self.heard.maps.append((message, payload))
        elif isinstance(message, ResultEnd):
            self.heard.ends.append(message)

    def close(self) -> None:
        self._socket.close(0)


class SweepSource:
    """One scan: its file, the live lane and the status lane."""

    def __init__(self, run_dir: Path, folder: Path, frames: list[NDArray[Any]], *, calibrated: bool = True) -> None:
        self.run_dir, self.folder, self.frames = run_dir, folder, frames
        self.scan_uid = uuid.uuid4().hex
        height, width = frames[0].shape[:2]
        self.format = FrameFormat(
            width=width,
            height=height,
            bit_depth=8 if frames[0].dtype == np.uint8 else 12,
            pixel_format="rgb" if frames[0].ndim == 3 else "mono",
        )
        self.plan = SweepPlan(0, 3 * (len(frames) - 1), 3, 3.175)
        self.start_message = Start(
            scan_uid=self.scan_uid,
            path=str(folder),
            format=self.format,
            plan=self.plan,
            config_toml="[reconstruct]\ncontrast = 60\nmedian = 3\n",
            calibration_json=calibration_json(width, height) if calibrated else "",
            user_json=json.dumps({"purpose": "object" if calibrated else "raw"}),
            start_time_utc="2026-01-01T00:00:00.000Z",
        )
        self.context: zmq.Context[Any] = zmq.Context()
        live = open_socket(self.context, zmq.PUB, "live")
        live.setsockopt(zmq.SNDHWM, 1000)  # what is lost here is lost on purpose, never by the speed of a test
        live.bind(endpoint(run_dir, "live"))
        self._live = Sender(live)
        self._status = Sender(bind(self.context, zmq.PUB, run_dir, "status"))
        self.file: ScanFile | None = None
        self.workers: list[subprocess.Popen[str]] = []
        self.listeners: list[Listener] = []
        self.outcome = ""

    def close(self) -> None:
        for worker in self.workers:
            if worker.poll() is None:
                worker.terminate()
            _, said = output_of(worker)
            print(said, file=sys.stderr)  # pytest shows it when the test fails
        for listener in self.listeners:
            listener.close()
        if self.file is not None:
            self.file.close()
        self._live.socket.close(0)
        self._status.socket.close(0)
        self.context.term()

    # ---- processes ----

    def start_worker(self) -> subprocess.Popen[str]:
        """Start a worker process and wait until it has bound its socket."""
        (self.run_dir / "results.sock").unlink(missing_ok=True)
        worker = self.start_worker_unready()
        wait_for(lambda: (self.run_dir / "results.sock").exists() or worker.poll() is not None, "a worker")
        return worker

    def start_worker_unready(self) -> subprocess.Popen[str]:
        """Start a worker process without waiting for anything."""
        worker = subprocess.Popen(
            [sys.executable, "-c", _WORKER, str(self.run_dir)],
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self.workers.append(worker)
        return worker

    def kill_worker(self) -> None:
        """SIGKILL the newest worker."""
        self.workers[-1].kill()
        output_of(self.workers[-1])

    def listen(self) -> Listener:
        listener = Listener(self.context, self.run_dir)
        self.listeners.append(listener)
        return listener

    def wait_for_subscribers(self, listener: Listener) -> None:
        """Return once the worker hears the live lane: frames sent before would be lost."""
        probe = Start(scan_uid="probe", path="/nonexistent", format=self.format, plan=self.plan)

        def answered() -> bool:
            self._live.send(probe)
            return any(progress.scan_uid == "probe" for progress in listener.poll().progress)

        # one at a time: a worker that is slow to answer finds no queue of them that hides what comes next
        wait_for(answered, "the worker listens to the live lane", pause=lambda: time.sleep(0.1))

    # ---- the scan ----

    def create(self) -> None:
        """Make the scan file, as the writer does before anything moves."""
        self.file = create_scan(self.folder, self.start_message)

    def announce(self) -> None:
        self._live.send(self.start_message)

    def image(self, index: int, **changes: Any) -> Image:
        fields: dict[str, Any] = {
            "scan_uid": self.scan_uid,
            "frame_index": index,
            "position_steps": self.plan.position_steps(index),
            "position_um": float(self.plan.positions_um()[index]),
            "shape": list(self.format.shape),
            "dtype": self.format.dtype,
            "bit_depth": self.format.bit_depth,
            "pixel_format": self.format.pixel_format,
            "crc32": frame_crc32(self.frames[index]),
        }
        return Image(**(fields | changes))

    def send_live(self, index: int, pixels: Any = None, **changes: Any) -> None:
        payload = self.frames[index].tobytes() if pixels is None else pixels
        self._live.send(self.image(index, **changes), payload)

    def send_live_raw(self, parts: list[bytes]) -> None:
        self._live.socket.send_multipart(parts)

    def commit(self, index: int) -> None:
        assert self.file is not None
        self.file.write_frame(self.image(index), self.frames[index])

    def take(self, index: int, *, live: bool = True) -> None:
        """Commit a frame and, unless it is lost there, send it on the live lane."""
        self.commit(index)
        if live:
            self.send_live(index)

    def end(self, outcome: Outcome = Outcome.COMPLETE, *, live: bool = True, missing: list[Any] | None = None) -> None:
        assert self.file is not None
        message = End(
            scan_uid=self.scan_uid,
            outcome=outcome,
            expected=len(self.frames),
            sent=len(self.frames),
            missing=missing or [],
            checks={"drift_px": 0.25},
        )
        if live:
            self._live.send(message)
        self.file.seal(outcome)
        self.outcome = outcome.value

    def say_status(self) -> None:
        """What the daemon says five times a second."""
        self._status.send(
            Status(
                state="sweeping",
                scan_uid=self.scan_uid,
                scan_path=str(self.folder),
                plan=self.plan,
                format=self.format,
                outcome=self.outcome or "running",
            )
        )

    def pump(self, condition: Callable[[], Any], what: str) -> Any:
        """Say the status over and over until ``condition``."""

        def turn() -> Any:
            self.say_status()
            return condition()

        return wait_for(turn, what)
