"""The simulated camera: renders the scene for the true stage position, one frame per trigger."""

from __future__ import annotations

import queue
import threading
import time
from collections import Counter
from collections.abc import Callable

from acquire.contract.config.model import RigConfig
from acquire.contract.config.simulation import SimulationConfig
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.process.clocks import mono_ns
from acquire.simulation import Renderer, SimulatedScene, build_scene

from .protocol import CameraFrame, CameraInfo, CameraSettings, CameraSink
from .scripted_faults import ScriptedFaults, parse_script

_QUEUE_FRAMES = 8
"""Exposures that wait for their picture; one more is lost, as on a camera whose memory is full."""
_LIMITS = {"exposure_ms": (0.01, 75.0), "gain": (0.0, 20.0), "brightness_percent": (0.0, 100.0)}


class SimulatedCamera:
    """Renders in a thread. Lamp and stage position are those at the moment of exposure."""

    def __init__(self, config: RigConfig, position_steps: Callable[[], float] = lambda: 0.0) -> None:
        """``position_steps`` tells where the projector stands, in microsteps, when a software trigger comes."""
        camera, simulation = config.camera, config.simulation
        self._config = config
        self._format = FrameFormat(
            width=camera.width,
            height=camera.height,
            bit_depth=simulation.bit_depth,
            pixel_format="rgb" if simulation.colour else "mono",
        )
        self._settings = CameraSettings(camera.exposure_ms, camera.gain, camera.brightness_percent)
        self._exposures: queue.Queue[tuple[float, float, int, int, int] | None] = queue.Queue(_QUEUE_FRAMES)
        self._thread: threading.Thread | None = None
        self._sink: CameraSink = lambda _frame: None
        self._armed = False
        self._frame_id = 0
        self._taken: Counter[int] = Counter()
        self._lamp = (False, 0, False)
        """On or off now, since when (CLOCK_MONOTONIC, ns), and what it was before."""
        self._position_steps = position_steps
        self.lost_exposures = 0
        self.scene: SimulatedScene | None = None
        self._faults = ScriptedFaults(parse_script(simulation.faults)) if simulation.faults else None

    @property
    def lamp_on(self) -> bool:
        """State of the lamp now."""
        return self._lamp[0]

    @lamp_on.setter
    def lamp_on(self, on: bool) -> None:
        self._lamp = (on, mono_ns(), self._lamp[0])

    def _lit_at(self, at_ns: int) -> bool:
        """State of the lamp at a recent time: a frame is rendered shortly after its exposure."""
        on, since_ns, before = self._lamp
        return on if at_ns >= since_ns else before

    def open(self, sink: CameraSink) -> CameraInfo:
        """Build the scene and start the thread."""
        self._sink = sink
        self.show(self.simulation)
        self._thread = threading.Thread(target=self._serve, name="simulated-camera", daemon=True)
        self._thread.start()
        return CameraInfo(kind="simulated", format=self._format, limits=dict(_LIMITS))

    @property
    def simulation(self) -> SimulationConfig:
        """Configuration of the simulated specimen and optics."""
        return self._config.simulation if self.scene is None else self.scene.config

    def show(self, simulation: SimulationConfig) -> None:
        """Compute the scene (a second or two) and show it from the next exposure on.

        Raises:
            ConfigError: a value out of its bounds; what was shown is still shown.
        """
        if self.scene is None or self.scene.config != simulation:
            um_per_microstep = self._config.stage.um_per_microstep
            width, height = self._format.width, self._format.height
            scene = build_scene(simulation, width=width, height=height, um_per_microstep=um_per_microstep)
        else:
            scene = self.scene
        renderer = Renderer(scene)
        # compile the kernels now, not during the first exposure, whose frame would be late
        renderer.render(0, exposure_ms=1.0, gain=0.0, brightness=0.0)
        self.scene, self._renderer = scene, renderer

    def close(self) -> None:
        """Stop delivering; idempotent."""
        self._armed = False
        if self._thread is not None:
            self._exposures.put(None)
            self._thread.join(timeout=10)
            self._thread = None

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Apply settings within the camera's limits; returns what is used."""
        clipped = {name: min(max(getattr(settings, name), low), high) for name, (low, high) in _LIMITS.items()}
        self._settings = CameraSettings(**clipped)
        return self._settings

    def arm(self) -> None:
        """Expose at each trigger from now on."""
        self._armed = True

    def disarm(self) -> None:
        """Ignore triggers."""
        self._armed = False

    def snap(self) -> None:
        """One exposure now."""
        self._expose(self._position_steps(), mono_ns())

    def on_trigger(self, position_steps: float, at_ns: int, travel_steps: float = 0.0, camera_ns: int = 0) -> None:
        """The trigger line: the stage is at ``position_steps`` at mid-exposure, and travels on during the exposure."""
        if self._armed:
            self._expose(position_steps, at_ns, travel_steps, camera_ns)

    def _expose(self, position_steps: float, at_ns: int, travel_steps: float = 0.0, camera_ns: int = 0) -> None:
        camera_frame_id, self._frame_id = self._frame_id, self._frame_id + 1
        try:
            self._exposures.put_nowait((position_steps, travel_steps, camera_frame_id, at_ns, camera_ns))
        except queue.Full:
            self.lost_exposures += 1

    def _serve(self) -> None:
        while (exposure := self._exposures.get()) is not None:
            position_steps, travel_steps, camera_frame_id, at_ns, camera_ns = exposure
            self._wait_for_exposure(at_ns)
            lamp, room = (1.0, 1.0) if self._faults is None else self._faults.begin()
            attempt = self._taken[round(position_steps)]
            self._taken[round(position_steps)] += 1
            pixels = self._renderer.render(
                position_steps,
                lamp=lamp if self._lit_at(at_ns + self._exposure_ns) else 0.0,
                room=room,
                exposure_ms=self._settings.exposure_ms,
                gain=self._settings.gain,
                brightness=self._settings.brightness_percent,
                attempt=attempt,
                travel_steps=travel_steps,
            )
            frame = CameraFrame(pixels, camera_frame_id, at_ns, camera_ns)
            for event in (frame,) if self._faults is None else self._faults.deliver(frame):
                self._sink(event)

    @property
    def _exposure_ns(self) -> int:
        return round(self._settings.exposure_ms * 1e6 * self._config.simulation.time_scale)

    def _wait_for_exposure(self, at_ns: int) -> None:
        """Deliver a frame no earlier than the end of its exposure."""
        remaining_s = (at_ns + self._exposure_ns) / 1e9 - time.monotonic()
        if remaining_s > 0:
            time.sleep(remaining_s)
