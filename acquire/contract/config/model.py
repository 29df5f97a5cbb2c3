"""Every key of rig.toml with its unit, its bounds and its default; the docstring under a key is its manual."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from .drivers import CameraKind, StageKind
from .simulation import SimulationConfig

PositiveMs = Annotated[float, Meta(gt=0, le=600_000)]
Ms = Annotated[float, Meta(ge=0, le=600_000)]
Seconds = Annotated[float, Meta(gt=0, le=86_400)]
Steps = Annotated[int, Meta(ge=-10_000_000, le=10_000_000)]
_NO_CONTROLS = r"^[^\x00-\x1f]*$"
Text = Annotated[str, Meta(max_length=4096, pattern=_NO_CONTROLS)]
"""A path, an address or a name: no control characters."""
Bytes = Annotated[int, Meta(ge=1_000_000, le=2**40)]


class StorageConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where scans are stored, and how often they are synced."""

    data_dir: Annotated[str, Meta(max_length=1024, pattern=_NO_CONTROLS)] = "~/sweepscope-scans"
    """Folder of all scans; it needs room for whole sweeps."""
    sync_every_frames: Annotated[int, Meta(ge=1, le=100_000)] = 64
    """Frames between two fdatasync: at most so many frames are at the mercy of a power cut."""


class StageConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The stepper-driven stage that carries the slide projector."""

    kind: StageKind = "simulated"
    """Which motion controller drives the stage."""
    port: Text = ""
    """Serial port of the controller; empty looks for the only one there is."""
    um_per_microstep: Annotated[float, Meta(gt=0, le=1000)] = 3.175
    """Travel of one microstep in um (0.001 inch per full step, 8 microsteps)."""
    travel_min_steps: Steps = 0
    """Soft limit, in microsteps from zero (the most distal position)."""
    travel_max_steps: Steps = 4500
    """Soft limit, in microsteps from zero."""
    run_up_steps: Annotated[int, Meta(ge=0, le=100_000)] = 48
    """Approach of frame 0 from outside, so that backlash lies on one side, in microsteps."""
    max_rate_steps_per_s: Annotated[float, Meta(gt=0, le=100_000)] = 2000.0
    """Highest speed in microsteps per second."""
    acceleration_steps_per_s2: Annotated[float, Meta(gt=0, le=10_000_000)] = 20_000.0
    """Acceleration in microsteps per second squared."""
    settle_ms: Ms = 5.0
    """Rest between the end of a step and the trigger, in ms."""
    motion_lease_ms: PositiveMs = 1000.0
    """The controller stops by itself when the host is silent for so long, in ms."""
    invert_direction: bool = False
    """True: positions grow while DIR is low (the motor's coils are the other way round)."""
    limit_switch: Literal["near", "far", "none"] = "near"
    """The end of the travel at which the limit switch is fitted; ``none``: the stage is zeroed by hand."""
    limit_closes: bool = False
    """True: the limit switch closes when pressed; the default opens, so that a broken wire stops the stage."""
    estop_closes: bool = False
    """The same for the emergency stop."""
    strobe_falls: bool = False
    """True: the camera's exposure output falls at the begin of the exposure."""


class CameraConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The camera and its settings at the start of a scan."""

    kind: CameraKind = "simulated"
    """Which camera driver is used; ``replay`` shows the pictures of a folder or a scan again."""
    device: Text = ""
    """``genicam``: the serial number, ``uvc``: /dev/videoN, ``replay``: the folder or the scan; empty: the only one."""
    producer: Text = ""
    """``genicam``: the maker's GenTL producer (.cti); empty: those in GENICAM_GENTL64_PATH."""
    trigger: Annotated[str, Meta(min_length=1, max_length=64)] = "Line1"
    """``genicam``: the input that the TRIGGER wire goes to; ``host``: the camera runs freely and the host picks the
    first frame that began after the stage stood still (always so for ``uvc`` and ``replay``; step mode only)."""
    width: Annotated[int, Meta(ge=16, le=16_384)] = 1024
    """Pixels per row."""
    height: Annotated[int, Meta(ge=16, le=16_384)] = 768
    """Rows."""
    exposure_ms: Annotated[float, Meta(gt=0, le=60_000)] = 30.0
    """Exposure (shutter) in ms."""
    gain: Annotated[float, Meta(ge=0, le=48)] = 6.0
    """Gain in dB."""
    brightness_percent: Annotated[float, Meta(ge=0, le=100)] = 0.0
    """Black level in percent of full scale."""
    frame_timeout_ms: PositiveMs = 2000.0
    """A frame that has not arrived so long after the end of its exposure is lost and taken again, in ms."""
    max_attempts: Annotated[int, Meta(ge=1, le=255)] = 4
    """A frame that was lost so many times is a fault (F16, F19)."""
    away_s: Seconds = 30.0
    """A camera that went away is waited for so long; then the sweep is interrupted and can be resumed, in s."""


class SweepConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The sweep that is run when a command names none of these."""

    first_steps: Steps = 0
    """Position of frame 0 in microsteps."""
    last_steps: Steps = 1578
    """Position of the last frame in microsteps; below first_steps sweeps the other way."""
    steps_per_frame: Annotated[int, Meta(ge=1, le=100_000)] = 3
    """Microsteps between two frames."""
    mode: Literal["step", "fly"] = "step"
    """``step`` stops for each frame; ``fly`` triggers at constant speed."""
    max_rate_hz: Annotated[float, Meta(gt=0, le=10_000)] = 15.0
    """Frames per second that are not exceeded."""
    repeat_first: bool = True
    """Take frame 0 once more after the sweep: a shift or a change of brightness is reported as drift."""
    check_limit: bool = True
    """Touch the limit switch again after the sweep: steps that were lost are reported."""
    dark_frames: bool = True
    """Take one frame of the ambient light, the lamp off, before the sweep."""


class ReconstructConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How frames become points when a command says nothing else."""

    calibration: Text = ""
    """Path of calibration.json; empty: the simulated rig's own, or none."""
    contrast: Annotated[int, Meta(ge=0, le=255)] = 70
    """Least brightness range of a pixel that is used, in counts of 8 bit."""
    median: Annotated[int, Meta(ge=0, le=31)] = 5
    """Side of the median filter on the contrast mask in pixels, odd; 0 for none."""
    method: Literal["linear", "probit", "fit", "auto"] = "auto"
    """Estimate of the crossing: linear (the paper's) or probit from two samples, fit (the whole edge), or auto."""
    noise_counts: Annotated[float, Meta(ge=0, le=255)] = 2.0
    """Standard deviation of a pixel's noise in counts of 8 bit, for sigma, until a noise model is measured."""


class CheckConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What ``calibrate check`` lets pass."""

    flatness_um: Annotated[float, Meta(gt=0, le=100_000)] = 10.0
    """Flatness error: range of the distances from the best plane, 3 of 1000 points left out, in um."""
    offset_um: Annotated[float, Meta(gt=0, le=100_000)] = 5.0
    """Mean distance of the points from the board's own pose, in um."""
    scale_percent: Annotated[float, Meta(gt=0, le=100)] = 0.1
    """Distances in the cloud against the board's squares, in percent."""
    repeatability_um: Annotated[float, Meta(gt=0, le=100_000)] = 2.0
    """Shift between two sweeps over the same thing, and standard deviation of a point, in um."""
    probing_form_um: Annotated[float, Meta(gt=0, le=100_000)] = 10.0
    """Probing error (form) on a sphere: range of the radial distances, 3 of 1000 points left out, in um."""
    probing_size_um: Annotated[float, Meta(gt=0, le=100_000)] = 5.0
    """Probing error (size): measured minus known diameter of a sphere, in um."""
    sphere_spacing_um: Annotated[float, Meta(gt=0, le=100_000)] = 5.0
    """Measured minus known distance of two spheres, in um."""


class LimitsConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Bounds on memory and on waiting."""

    window_bytes: Bytes = 256_000_000
    """Frames that the daemon keeps until the writer has committed them, in bytes: no room, no trigger."""
    fold_bytes: Bytes = 2_000_000_000
    """Memory of the fold in bytes; a format that needs more is refused before anything moves."""
    writer_start_s: Seconds = 5.0
    """A sweep is refused when no writer has made its file ready by then, in s."""
    writer_lost_s: Seconds = 2.0
    """The writer counts as away when it has said nothing for so long while frames wait, in s."""
    seal_s: Seconds = 120.0
    """Longest wait for the writer to verify and seal a scan, in s."""
    stop_s: Seconds = 10.0
    """Longest wait for the stage and the camera when a service is told to end, in s."""
    command_s: Seconds = 5.0
    """Longest wait of a client for a reply, in s."""
    status_hz: Annotated[float, Meta(gt=0, le=100)] = 5.0
    """Status messages per second when nothing changes."""


class LampConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The projector's lamp."""

    warm_up_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    """Wait after switching the lamp on, in s."""


class ViewerConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The page in the browser."""

    host: Text = "127.0.0.1"
    """Address to bind; anything but loopback makes the page view-only."""
    port: Annotated[int, Meta(ge=0, le=65_535)] = 8080
    """TCP port; 0 takes any free one."""
    max_points: Annotated[int, Meta(ge=1000, le=20_000_000)] = 2_000_000
    """Points sent to a browser; a larger cloud is thinned evenly and the page says so."""
    max_bytes_per_s: Annotated[float, Meta(ge=50_000, le=1e9)] = 16_000_000.0
    """Bytes per second that one browser is sent at most."""


class NetworkConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The way in from other machines, for those whose key is allowed ('sweepscope keys')."""

    host: Text = ""
    """Address to bind; empty: nothing is offered to other machines. 0.0.0.0 offers to every network there is."""
    port: Annotated[int, Meta(ge=1, le=65_532)] = 5570
    """First of four TCP ports: status, results, preview, commands."""
    keys_dir: Text = ""
    """Folder of the rig's key and of the list of allowed keys; empty: of an installed rig /etc/sweepscope/keys."""


class RigConfig(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """rig.toml as a whole."""

    storage: StorageConfig = StorageConfig()
    stage: StageConfig = StageConfig()
    camera: CameraConfig = CameraConfig()
    sweep: SweepConfig = SweepConfig()
    reconstruct: ReconstructConfig = ReconstructConfig()
    check: CheckConfig = CheckConfig()
    limits: LimitsConfig = LimitsConfig()
    lamp: LampConfig = LampConfig()
    viewer: ViewerConfig = ViewerConfig()
    network: NetworkConfig = NetworkConfig()
    simulation: SimulationConfig = SimulationConfig()

    @property
    def time_scale(self) -> float:
        """Factor of waits for the stage and the lamp: 1 where they are real."""
        return self.simulation.time_scale if self.stage.kind == "simulated" else 1.0
