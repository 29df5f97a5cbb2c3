"""Checks of the machine and of stage and camera; each function answers with one finding and, if needed, its fix."""

from __future__ import annotations

import grp
import os
import platform
import pwd
import shutil
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal

from acquire.contract.config.drivers import CAMERA_NODES
from acquire.contract.config.load import LoadedConfig
from acquire.contract.config.model import CameraConfig, StageConfig
from acquire.contract.messaging.messages import Status
from acquire.contract.units import format_bytes
from tui.install.machine import InstallError, run

Level = Literal["ok", "note", "wrong"]
SPEED_BYTES = 64_000_000
OLDEST_PYTHON = (3, 11)
OLDEST_YEAR = 2025
GROUP = "sweepscope"
DEV = Path("/dev")
STAGE_NODES = ("sweepscope-stage", "serial/by-id/*", "tty[AU][CS][MB]*")
"""Patterns of USB serial ports below /dev: the link of our udev rule, stable names, ttyACM and ttyUSB."""


@dataclass(frozen=True)
class DoctorFinding:
    """The result of one check."""

    name: str
    level: Level
    text: str
    fix: str = ""
    """What to do; empty if nothing."""


# ---- the machine ----


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> DoctorFinding:
    """Python is new enough."""
    text = f"Python {'.'.join(map(str, version[:3]))}, {platform.machine()}"
    if tuple(version[:2]) < OLDEST_PYTHON:
        return DoctorFinding("python", "wrong", text, "install Python 3.11 or newer and run the installer with it")
    return DoctorFinding("python", "ok", text)


@dataclass(frozen=True)
class Login:
    """The user who runs the check, and the group of the rig."""

    name: str
    is_root: bool
    group_members: tuple[str, ...] | None
    """Members of the group; None: there is no such group."""
    in_group: bool
    """This login session has the group."""


def this_login() -> Login:
    """The login of this process."""
    name = pwd.getpwuid(os.getuid()).pw_name
    try:
        group = grp.getgrnam(GROUP)
    except KeyError:
        return Login(name, os.getuid() == 0, None, False)
    in_group = group.gr_gid in (*os.getgroups(), os.getegid())
    return Login(name, os.getuid() == 0, tuple(group.gr_mem), in_group)


def check_groups(login: Login, *, installed: bool) -> DoctorFinding:
    """The user may use a rig that is installed for the machine."""
    if not installed:
        return DoctorFinding("groups", "ok", "not installed for the machine: services run as you")
    if login.group_members is None:
        return DoctorFinding("groups", "wrong", f"there is no group {GROUP}", "sudo sweepscope install, from the clone")
    if login.is_root or login.in_group:
        return DoctorFinding("groups", "ok", f"{login.name} may use the rig")
    if login.name in login.group_members:
        text = f"{login.name} is in the group, but this login session began before that"
        return DoctorFinding("groups", "wrong", text, "log in again")
    fix = f"sudo usermod -aG {GROUP} {login.name}, then log out and in again"
    return DoctorFinding("groups", "wrong", f"{login.name} is not in the group {GROUP}", fix)


def _frame_bytes(config: LoadedConfig) -> int:
    camera = config.rig.camera
    return camera.width * camera.height * (2 if config.rig.simulation.bit_depth > 8 else 1)


def scan_bytes(config: LoadedConfig) -> int:
    """Size in bytes of the sweep that the configuration describes."""
    sweep = config.rig.sweep
    return (abs(sweep.last_steps - sweep.first_steps) // sweep.steps_per_frame + 1) * _frame_bytes(config)


def needed_bytes_per_s(config: LoadedConfig) -> float:
    """Highest data rate of the camera."""
    return _frame_bytes(config) * min(config.rig.sweep.max_rate_hz, 1000.0 / config.rig.camera.exposure_ms)


def check_space(folder: Path, free_bytes: int, needed_bytes: int) -> DoctorFinding:
    """There is space for a sweep, and better for ten."""
    text = f"{format_bytes(free_bytes)} free in {folder}, a sweep needs {format_bytes(needed_bytes)}"
    if free_bytes < needed_bytes:
        return DoctorFinding("space", "wrong", text, "make room, or set storage.data_dir")
    if free_bytes < 10 * needed_bytes:
        return DoctorFinding("space", "note", text, "make room soon")
    return DoctorFinding("space", "ok", text)


def free_bytes(folder: Path) -> int:
    """Free space where the folder is, or will be created."""
    return shutil.disk_usage(_existing(folder)).free


def check_speed(folder: Path, needed_per_s: float) -> DoctorFinding:
    """The disk is as fast as the camera (with a slower one the stage waits; no frame is lost)."""
    place = _existing(folder)
    if not os.access(place, os.W_OK):
        return DoctorFinding("disk speed", "note", f"you may not write to {place}: not measured")
    written_per_s = measure_disk(place)
    text = f"{written_per_s / 1e6:.0f} MB/s to the disk, the camera makes {needed_per_s / 1e6:.0f} MB/s at most"
    if written_per_s < needed_per_s:
        return DoctorFinding("disk speed", "wrong", text, "use a faster disk, or lower sweep.max_rate_hz")
    return DoctorFinding("disk speed", "ok", text)


def measure_disk(folder: Path) -> float:
    """Bytes per second of writing 64 MB, fdatasync included."""
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


def _existing(path: Path) -> Path:
    while not path.exists():
        path = path.parent
    return path


def check_clock(now: datetime, set_by_network: bool | None) -> DoctorFinding:
    """The date is plausible: scans are named by it.

    Args:
        now: the wall clock.
        set_by_network: the clock is synchronised; None: not known.
    """
    if now.year < OLDEST_YEAR:
        return DoctorFinding("clock", "wrong", f"the date is {now:%Y-%m-%d}", "set it: sudo timedatectl set-ntp true")
    if set_by_network is False:
        return DoctorFinding("clock", "note", "the clock is not set by the network", "sudo timedatectl set-ntp true")
    return DoctorFinding("clock", "ok", f"{now:%Y-%m-%d %H:%M} UTC")


def clock_set_by_network() -> bool | None:
    """NTPSynchronized of timedatectl; None where it cannot be asked."""
    if not shutil.which("timedatectl") or not Path("/run/dbus/system_bus_socket").exists():
        return None
    try:
        said = run("timedatectl", "show", "--property=NTPSynchronized", "--value", timeout_s=5).strip()
    except InstallError:
        return None
    return said == "yes" if said in ("yes", "no") else None


def utc_now() -> datetime:
    """The wall clock."""
    return datetime.now(UTC)


# ---- stage and camera ----


def _nodes(dev: Path, patterns: Sequence[str]) -> list[str]:
    """The nodes of the first pattern that matches any."""
    return next((found for pattern in patterns if (found := sorted(map(str, dev.glob(pattern))))), [])


def serial_ports(dev: Path = DEV) -> list[str]:
    """Serial ports of USB devices, by stable names where there are any."""
    return _nodes(dev, STAGE_NODES)


def camera_nodes(dev: Path = DEV) -> dict[str, list[str]]:
    """Device nodes of cameras by driver, by stable names where there are any."""
    return {kind: _nodes(dev, patterns) for kind, patterns in CAMERA_NODES.items()}


def check_stage(stage: StageConfig, dev: Path = DEV) -> DoctorFinding:
    """The controller's port exists and may be opened."""
    if stage.kind == "simulated" or stage.port == "emulator":
        return DoctorFinding("stage", "ok", "simulated" if stage.kind == "simulated" else "the emulated controller")
    found = serial_ports(dev)
    port = stage.port or next(iter(found), "")
    if not port:
        return DoctorFinding("stage", "wrong", "no serial port is there", "plug the controller in, or set stage.port")
    if not stage.port and len(found) > 1:
        fix = "set stage.port in rig.toml to the controller's"
        return DoctorFinding("stage", "wrong", f"more than one serial port is there: {', '.join(found)}", fix)
    if not Path(port).exists():
        others = ", ".join(found) or "none"
        return DoctorFinding("stage", "wrong", f"{port} is not there (found: {others})", "set stage.port in rig.toml")
    return _not_accessible("stage", port) or DoctorFinding("stage", "ok", f"{stage.kind} on {port}")


def check_camera(camera: CameraConfig, status: Status | None, dev: Path = DEV) -> DoctorFinding:
    """The camera exists and may be opened, or the daemon has it open."""
    if camera.kind == "simulated":
        return DoctorFinding("camera", "ok", camera.kind)
    if status is not None and status.camera_kind == camera.kind:
        return DoctorFinding("camera", "ok", f"the daemon has the {camera.kind} camera open")
    if (found := camera_nodes(dev).get(camera.kind)) is not None:
        if not found:
            return DoctorFinding("camera", "wrong", "no video device is there", "plug the camera in")
        return _not_accessible("camera", found[0]) or DoctorFinding(
            "camera", "ok", f"{camera.kind}: {', '.join(found)}"
        )
    if status is not None:
        text = f"the configuration asks for a {camera.kind} camera, the daemon runs a {status.camera_kind} one"
        return DoctorFinding("camera", "wrong", text, "restart the daemon: sudo systemctl restart sweepscope-daemon")
    return DoctorFinding("camera", "note", f"{camera.kind}: only a running daemon can see it", "start the services")


def check_firmware(stage: StageConfig, status: Status | None) -> DoctorFinding:
    """The version of the firmware; the daemon does not start with one that it cannot talk to."""
    if (status.stage_kind if status is not None else stage.kind) == "simulated":
        return DoctorFinding("firmware", "ok", "none: the stage is simulated")
    if status is None:
        fix = "start the services; if the daemon refuses the firmware: make -C firmware flash PORT=..."
        return DoctorFinding("firmware", "note", "not known: no daemon answers", fix)
    if not status.stage_version:
        return DoctorFinding("firmware", "note", f"the {status.stage_kind} controller does not report its version")
    if status.stage_kind == "legacy":
        fix = "flash ours when the wiring allows: it counts positions and triggers (docs/wiring.md)"
        return DoctorFinding("firmware", "note", status.stage_version, fix)
    return DoctorFinding("firmware", "ok", f"version {status.stage_version}")


def _not_accessible(name: str, device: str) -> DoctorFinding | None:
    if os.access(device, os.R_OK | os.W_OK):
        return None
    try:
        fix = f"join the group {Path(device).group()}: sudo usermod -aG {Path(device).group()} $USER; log in again"
    except (KeyError, OSError):
        fix = "look at its permissions: sudo sweepscope install puts the rules for devices in place"
    return DoctorFinding(name, "wrong", f"{device} may not be opened", fix)
