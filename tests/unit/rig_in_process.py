"""A daemon with a small simulated rig in a thread of its own, for tests that speak to it as clients do."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Self
from unittest.mock import MagicMock

import zmq

from acquire.cameras.protocol import CameraFrame, CameraInfo, CameraSettings
from acquire.contract.config.load import load_config
from acquire.contract.config.model import RigConfig
from acquire.contract.messaging.lanes import connect, receive
from acquire.contract.messaging.messages import FrameFormat, Picture
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.daemon.service import Daemon
from acquire.rigs.base import DeviceEvent, Rig
from acquire.rigs.build import build_rig
from acquire.stages.protocol import StageStatus
from tests.waiting import DEADLINE_S, WALL_CLOCK_S, wait_for
from tui.client.rig_client import RigClient

SMALL = {
    "camera.width": 64,
    "camera.height": 48,
    "simulation.time_scale": 0.01,
    "sweep.max_rate_hz": 1000.0,
    "sweep.steps_per_frame": 12,
    "limits.status_hz": 50.0,
    "limits.writer_start_s": 0.2,
    "limits.stop_s": 0.3,
    "sweep.check_limit": False,
}


class AdjustableClock:
    """CLOCK_MONOTONIC plus ``ahead_ns``; it can stand still."""

    def __init__(self, ahead_ns: int = 0) -> None:
        self._ahead_ns = ahead_ns
        self._frozen_ns: int | None = None

    def now_ns(self) -> int:
        """The time that the daemon goes by."""
        if self._frozen_ns is not None:
            return self._frozen_ns
        return MonotonicClock().now_ns() + self._ahead_ns

    def freeze(self) -> None:
        """Stand still."""
        self._frozen_ns = self.now_ns()

    def thaw(self) -> None:
        """Go on, as if it had not stood still."""
        self._frozen_ns = None


def known_rig(frame_format: FrameFormat, exposure_ms: float) -> Rig:
    """A rig without devices that knows what an open one does, but no calibration of its own."""
    rig = Rig(MagicMock(), MagicMock())
    rig.stage.status.return_value = StageStatus(0, True, "zero", False, 0)
    rig.camera_info = CameraInfo(kind="x", format=frame_format)
    rig.camera_settings = CameraSettings(exposure_ms, 0, 0)
    return rig


class RigInProcess:
    """Use it in a ``with`` block; ``settings`` are section.key -> value."""

    def __init__(
        self,
        run_dir: Path,
        data_dir: Path,
        settings: dict[str, Any],
        make_rig: Callable[[RigConfig], Rig] = build_rig,
        clock: Clock | None = None,
    ) -> None:
        self.run_dir = run_dir
        self.events: list[DeviceEvent] = []
        """What the devices told the daemon."""
        config = load_config(overrides=SMALL | {"storage.data_dir": str(data_dir)} | settings, environ={})
        self.daemon = Daemon(config, run_dir, self._overheard(make_rig(config.rig)), clock)
        self._thread = threading.Thread(target=self.daemon.run, name="daemon")

    def _overheard(self, rig: Rig) -> Rig:
        """Note the events of the devices on their way, and let :meth:`emit` add others."""
        open_devices = rig.open

        def opened(sink: Callable[[DeviceEvent], None], settings: CameraSettings) -> None:
            def tell(event: DeviceEvent) -> None:
                sink(event)
                self.events.append(event)

            self.emit = tell
            open_devices(tell, settings)

        rig.open = opened  # type: ignore[method-assign]
        return rig

    def frames(self) -> int:
        """Pictures that the camera has delivered."""
        return sum(isinstance(event, CameraFrame) for event in self.events)

    def __enter__(self) -> Self:
        self._context: zmq.Context[Any] = zmq.Context()
        self._watchers: list[zmq.Socket[Any]] = []
        self.daemon.open()
        self._thread.start()
        self._client = RigClient(self.run_dir, timeout_s=DEADLINE_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.daemon.request_end()
        self._thread.join(WALL_CLOCK_S)
        self.daemon.close()
        self._client.close()
        for socket in self._watchers:
            socket.close()
        self._context.destroy(linger=0)

    def ask(self, name: str, /, **args: Any) -> dict[str, Any]:
        """One command as a client without a name."""
        return self._client.request(name, **args).result

    def ask_as(self, who: str, name: str, **args: Any) -> dict[str, Any]:
        """One command as client ``who``."""
        self._client.client = who
        try:
            return self.ask(name, **args)
        finally:
            self._client.client = ""

    def status(self) -> dict[str, Any]:
        """The rig as it is now: asked for, so never older than what was asked before."""
        return self.ask("status")

    def until(self, wanted: Callable[[dict[str, Any]], Any], what: str) -> dict[str, Any]:
        """Ask until the status is as wanted."""
        seen: list[dict[str, Any]] = []

        def there() -> bool:
            seen[:] = [self.status()]
            return bool(wanted(seen[0]))

        wait_for(there, what, pause=lambda: None, why=lambda: seen[0])
        return seen[0]

    def watch(self) -> zmq.Socket[Any]:
        """A subscriber of the preview lane."""
        socket = connect(self._context, zmq.SUB, self.run_dir, "preview")
        self._watchers.append(socket)
        self.until_true(lambda: self.daemon.preview.watched, "the daemon knows that somebody watches")
        return socket

    @staticmethod
    def until_true(condition: Callable[[], Any], what: str) -> None:
        """Wait for something with a deadline."""
        wait_for(condition, what)

    @staticmethod
    def picture(socket: zmq.Socket[Any]) -> tuple[Picture, bytes]:
        """The next picture."""
        wait_for(lambda: socket.poll(200), "a picture")
        received = receive(socket)
        assert received is not None and isinstance(received.message, Picture) and received.payload is not None
        return received.message, received.payload.bytes
