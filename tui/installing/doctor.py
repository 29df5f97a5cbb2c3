"""Looks over what people get wrong, and says the mend of each; every check is a function that answers, never raises."""

from __future__ import annotations

import grp
import json
import os
import platform
import pwd
import shutil
import stat
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from acquire.contract.config import LoadedConfig
from acquire.contract.errors import NoServiceError, SweepscopeError
from acquire.contract.messages import Status
from acquire.contract.places import client_run_dir
from acquire.contract.units import format_bytes
from tui.installing.machine import InstallError, run
from tui.installing.places import machine_places

Level = Literal["ok", "note", "wrong"]
SPEED_BYTES = 64_000_000
CALIBRATION_DAYS = 90
OLDEST_PYTHON = (3, 11)


@dataclass(frozen=True)
class Finding:
    """What one check says."""

    name: str
    level: Level
    text: str
    mend: str = ""
    """What to do; empty if nothing."""


def examine(config: LoadedConfig, status: Callable[[], Status]) -> Iterator[Finding]:
    """All checks in the order in which they matter.

    Args:
        config: the effective configuration.
        status: asks the running daemon (raises SweepscopeError).
    """
    checks: tuple[Callable[[], Finding], ...] = (
        _python,
        lambda: _groups(machine_places().home.exists()),
        lambda: _stage(config),
        lambda: _camera(config),
        lambda: _space(config),
        lambda: _speed(config),
        lambda: _calibration(config),
        _clock,
        _sockets,
        lambda: _services(status),
    )
    for check in checks:
        try:
            yield check()
        except (OSError, SweepscopeError) as error:
            yield Finding("check", "wrong", str(error), "see the text")


def _python() -> Finding:
    text = f"Python {platform.python_version()}"
    if sys.version_info < OLDEST_PYTHON:
        return Finding("python", "wrong", text, "install Python 3.11 or newer and run the installer with it")
    return Finding("python", "ok", text)


def _groups(installed: bool) -> Finding:
    if not installed:
        return Finding("groups", "ok", "not installed for the machine: services run as you")
    name = pwd.getpwuid(os.getuid()).pw_name
    mend = f"sudo usermod -aG sweepscope {name}, then log out and in again"
    try:
        group = grp.getgrnam("sweepscope")
    except KeyError:
        return Finding("groups", "wrong", "there is no group sweepscope", "sudo sweepscope install")
    if os.getuid() == 0 or group.gr_gid in os.getgroups():
        return Finding("groups", "ok", f"{name} may use the rig")
    if name in group.gr_mem:
        return Finding("groups", "wrong", f"{name} is in the group, but this login does not know", "log out and in")
    return Finding("groups", "wrong", f"{name} is not in the group sweepscope", mend)


def serial_ports() -> list[str]:
    """Serial ports of USB devices, the stable names first."""
    stable = [Path("/dev/sweepscope-stage"), *sorted(Path("/dev/serial/by-id").glob("*"))]
    found = [path for path in stable if path.exists()]
    return [str(path) for path in found or sorted([*Path("/dev").glob("ttyACM*"), *Path("/dev").glob("ttyUSB*")])]


def cameras() -> list[str]:
    """Video devices by their stable names."""
    found = sorted(Path("/dev/v4l/by-id").glob("*-index0")) or sorted(Path("/dev").glob("video*"))
    return [str(path) for path in found]


def _stage(config: LoadedConfig) -> Finding:
    stage = config.rig.stage
    if stage.kind == "simulated":
        return Finding("stage", "ok", "simulated")
    port = stage.port or next(iter(serial_ports()), "")
    if not port:
        return Finding("stage", "wrong", "no serial port is there", "plug the controller in, or set stage.port")
    if not Path(port).exists():
        others = ", ".join(serial_ports()) or "none"
        return Finding("stage", "wrong", f"{port} is not there (found: {others})", "set stage.port in rig.toml")
    if not os.access(port, os.R_OK | os.W_OK):
        owner = Path(port).group()
        return Finding("stage", "wrong", f"{port} may not be opened", f"join the group {owner}")
    return Finding("stage", "ok", f"{stage.kind} on {port}")


def _camera(config: LoadedConfig) -> Finding:
    kind = config.rig.camera.kind
    if kind != "uvc":
        return Finding("camera", "ok", kind)
    if not cameras():
        return Finding("camera", "wrong", "no video device is there", "plug the camera in")
    return Finding("camera", "ok", f"{kind}: {', '.join(cameras())}")


def _scan_bytes(config: LoadedConfig) -> int:
    sweep, camera = config.rig.sweep, config.rig.camera
    frames = abs(sweep.last_steps - sweep.first_steps) // sweep.steps_per_frame + 1
    return frames * camera.width * camera.height * (2 if config.rig.simulation.bit_depth > 8 else 1)


def _existing(path: Path) -> Path:
    while not path.exists():
        path = path.parent
    return path


def _space(config: LoadedConfig) -> Finding:
    folder = _existing(config.data_dir)
    free, needed = shutil.disk_usage(folder).free, _scan_bytes(config)
    text = f"{format_bytes(free)} free in {config.data_dir}, a sweep needs {format_bytes(needed)}"
    if free < needed:
        return Finding("space", "wrong", text, "make room, or set storage.data_dir")
    return Finding(
        "space", "note" if free < 10 * needed else "ok", text, "make room soon" if free < 10 * needed else ""
    )


def _speed(config: LoadedConfig) -> Finding:
    folder = _existing(config.data_dir)
    if not os.access(folder, os.W_OK):
        return Finding("disk speed", "note", f"{folder} is not yours to write: not measured", "")
    written_per_s = measure_disk(folder)
    camera, sweep = config.rig.camera, config.rig.sweep
    needed = camera.width * camera.height * min(sweep.max_rate_hz, 1000.0 / camera.exposure_ms)
    text = f"{written_per_s / 1e6:.0f} MB/s to the disk, the camera makes {needed / 1e6:.0f} MB/s at most"
    if written_per_s < needed:
        return Finding("disk speed", "wrong", text, "use a faster disk, or lower sweep.max_rate_hz")
    return Finding("disk speed", "ok", text)


def measure_disk(folder: Path) -> float:
    """Bytes per second of writing 64 MB and pressing them onto the disk."""
    path = folder / f".speed-{os.getpid()}"
    block = os.urandom(1_000_000)
    try:
        with path.open("wb", buffering=0) as file:
            begin = time.perf_counter()
            for _ in range(SPEED_BYTES // len(block)):
                file.write(block)
            os.fdatasync(file.fileno())
            return SPEED_BYTES / (time.perf_counter() - begin)
    finally:
        path.unlink(missing_ok=True)


def _calibration(config: LoadedConfig) -> Finding:
    name = config.rig.reconstruct.calibration
    if not name:
        if config.rig.camera.kind == "simulated":
            return Finding("calibration", "ok", "the simulated rig knows its own")
        return Finding("calibration", "note", "none: maps, no cloud", "set reconstruct.calibration")
    path = Path(name).expanduser()
    try:
        age_days = _age_days(json.loads(path.read_text(encoding="utf-8")), path)
    except (OSError, ValueError) as error:
        return Finding("calibration", "wrong", f"{path}: {error}", "set reconstruct.calibration to a readable file")
    text = f"{path} is {age_days:.0f} days old"
    if age_days > CALIBRATION_DAYS:
        return Finding("calibration", "note", text, "calibrate again")
    return Finding("calibration", "ok", text)


def _age_days(calibration: dict[str, Any], path: Path) -> float:
    created = (calibration.get("valid_for") or {}).get("created_utc")
    moment = datetime.fromisoformat(created) if created else datetime.fromtimestamp(path.stat().st_mtime, UTC)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return (datetime.now(UTC) - moment).total_seconds() / 86_400


def _clock() -> Finding:
    if datetime.now(UTC).year < 2025:
        return Finding(
            "clock", "wrong", f"the clock says {datetime.now(UTC):%Y-%m-%d}", "set it: timedatectl set-ntp true"
        )
    if shutil.which("timedatectl") and Path("/run/dbus/system_bus_socket").exists():
        try:
            said = run("timedatectl", "show", "--property=NTPSynchronized", "--value", timeout_s=5).strip()
        except InstallError as error:
            return Finding("clock", "note", str(error))
        if said == "no":
            return Finding("clock", "note", "the clock is not set by the network", "timedatectl set-ntp true")
    return Finding("clock", "ok", f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC")


def _sockets() -> Finding:
    try:
        folder = client_run_dir()
    except NoServiceError as error:
        return Finding("sockets", "wrong", str(error), "sudo systemctl start sweepscope.target, or 'sweepscope up'")
    mode = stat.S_IMODE(folder.stat().st_mode)
    if mode & 0o007:
        return Finding("sockets", "wrong", f"{folder} is open to all users", f"chmod o= {folder}")
    return Finding("sockets", "ok", f"{folder}, mode {mode:04o}")


def _services(status: Callable[[], Status]) -> Finding:
    try:
        now = status()
    except SweepscopeError as error:
        return Finding("services", "wrong", str(error), "see 'sweepscope logs --service daemon'")
    text = f"daemon {now.state}, {now.stage_kind} stage, {now.camera_kind} camera"
    if not now.writer_alive:
        return Finding("services", "wrong", f"{text}; the writer is away", "see 'sweepscope logs --service writer'")
    faults = ", ".join(sorted({fault.code for fault in now.faults}))
    return Finding("services", "note" if faults else "ok", text + (f"; faults {faults}" if faults else ""))
