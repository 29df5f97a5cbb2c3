"""Builds the rig that the configuration names.

Drivers are imported when they are chosen: a real rig needs neither numba nor the AVR tools, a simulated one no camera
maker's libraries.
"""

from __future__ import annotations

import sys
from types import ModuleType

from acquire.cameras.protocol import HostFiredCamera
from acquire.contract.config.drivers import CAMERA_KINDS, STAGE_KINDS
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import ConfigError
from acquire.rigs.base import HOST_TRIGGER, HostFiredRig, Rig
from acquire.stages.protocol import Stage


def build_rig(config: RigConfig) -> Rig:
    """The rig that the configuration names.

    Raises:
        ConfigError: devices that cannot work together.
    """
    stage, camera = config.stage, config.camera
    if camera.kind == "simulated" and stage.kind == "simulated":
        from .simulated import SimulatedRig  # noqa: PLC0415

        return SimulatedRig(config)
    if camera.kind == "simulated" and stage.kind == "uno" and stage.port == "emulator":
        from .twin import TwinRig  # noqa: PLC0415

        return TwinRig(config)
    if camera.kind == "simulated":
        raise ConfigError("a simulated camera sees no real stage: set camera.kind to your camera's, or 'replay'")
    if camera.kind in ("uvc", "replay") or (camera.kind == "genicam" and camera.trigger == HOST_TRIGGER):
        return HostFiredRig(_stage(config), _host_fired(config))
    if camera.kind != "genicam":
        raise ConfigError(f"camera.kind = {camera.kind!r} has no driver here: give one of {', '.join(CAMERA_KINDS)}")
    if stage.kind != "uno":
        raise ConfigError(
            f"a {stage.kind} stage has no TRIGGER wire: set camera.trigger = '{HOST_TRIGGER}', or use the Uno"
        )
    return Rig(_stage(config), _genicam().GenicamCamera(camera))


def _stage(config: RigConfig) -> Stage:
    if config.stage.kind == "uno":
        from acquire.stages.uno.stage import UnoStage  # noqa: PLC0415

        return UnoStage(config.stage)
    if config.stage.kind == "legacy":
        from acquire.stages.legacy import LegacyStage  # noqa: PLC0415

        return LegacyStage(config.stage)
    if config.stage.kind != "simulated":
        raise ConfigError(
            f"stage.kind = {config.stage.kind!r} has no driver here: give one of {', '.join(STAGE_KINDS)}"
        )
    from acquire.stages.simulated import SimulatedStage  # noqa: PLC0415

    return SimulatedStage(config.stage, lambda *_shot: None, time_scale=config.simulation.time_scale)


def _host_fired(config: RigConfig) -> HostFiredCamera:
    if config.camera.kind == "replay":
        from acquire.cameras.replay import ReplayCamera  # noqa: PLC0415

        return ReplayCamera(config)
    from acquire.cameras.free_running import FreeRunningCamera  # noqa: PLC0415

    if config.camera.kind == "uvc":
        from acquire.cameras.uvc import UvcSource  # noqa: PLC0415

        return FreeRunningCamera(UvcSource(config.camera))
    return FreeRunningCamera(_genicam().GenicamDevice(config.camera))


def _genicam() -> ModuleType:
    """The driver of GenICam cameras; ConfigError where GenICam's library cannot be loaded."""
    try:
        from acquire.cameras import genicam  # noqa: PLC0415 - it loads the camera makers' libraries
    except ImportError as error:
        python = f"{sys.version_info[0]}.{sys.version_info[1]}"
        raise ConfigError(
            f"camera.kind = 'genicam' needs GenICam's library, which exists for x86-64 and on Debian needs the package "
            f"libpython{python}: {error}"
        ) from error
    return genicam
