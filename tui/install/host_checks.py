"""Looks at what the machine gives: Python, the rig's group, room and speed of the disk, the clock."""

from __future__ import annotations

import grp
import os
import platform
import pwd
import shutil
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from acquire.contract.config.load import LoadedConfig
from acquire.contract.units import format_bytes
from tui.install.finding import Finding
from tui.install.machine import InstallError, run

SPEED_BYTES = 64_000_000
OLDEST_PYTHON = (3, 11)
OLDEST_YEAR = 2025
GROUP = "sweepscope"


def check_python(version: tuple[int, ...] = sys.version_info[:3]) -> Finding:
    """New enough."""
    text = f"Python {'.'.join(map(str, version[:3]))}, {platform.machine()}"
    if tuple(version[:2]) < OLDEST_PYTHON:
        return Finding("python", "wrong", text, "install Python 3.11 or newer and run the installer with it")
    return Finding("python", "ok", text)


@dataclass(frozen=True)
class Login:
    """Who asks, and what the machine knows of the rig's group."""

    name: str
    is_root: bool
    group_members: tuple[str, ...] | None
    """Who is in the rig's group; None: there is no such group."""
    in_group: bool
    """This very login has the group."""


def this_login() -> Login:
    """The login that runs us."""
    name = pwd.getpwuid(os.getuid()).pw_name
    try:
        group = grp.getgrnam(GROUP)
    except KeyError:
        return Login(name, os.getuid() == 0, None, False)
    in_group = group.gr_gid in (*os.getgroups(), os.getegid())
    return Login(name, os.getuid() == 0, tuple(group.gr_mem), in_group)


def check_groups(login: Login, *, installed: bool) -> Finding:
    """Whoever asks may use the rig that is installed for the machine."""
    if not installed:
        return Finding("groups", "ok", "not installed for the machine: services run as you")
    if login.group_members is None:
        return Finding("groups", "wrong", f"there is no group {GROUP}", "sudo sweepscope install, from the clone")
    if login.is_root or login.in_group:
        return Finding("groups", "ok", f"{login.name} may use the rig")
    if login.name in login.group_members:
        return Finding("groups", "wrong", f"{login.name} is in the group, but this login does not know", "log in again")
    mend = f"sudo usermod -aG {GROUP} {login.name}, then log out and in again"
    return Finding("groups", "wrong", f"{login.name} is not in the group {GROUP}", mend)


def scan_bytes(config: LoadedConfig) -> int:
    """Size of the sweep that the configuration describes, in bytes."""
    sweep, camera = config.rig.sweep, config.rig.camera
    frames = abs(sweep.last_steps - sweep.first_steps) // sweep.steps_per_frame + 1
    return frames * camera.width * camera.height * (2 if config.rig.simulation.bit_depth > 8 else 1)


def check_space(folder: Path, free_bytes: int, needed_bytes: int) -> Finding:
    """There is room for a sweep, and better for ten."""
    text = f"{format_bytes(free_bytes)} free in {folder}, a sweep needs {format_bytes(needed_bytes)}"
    if free_bytes < needed_bytes:
        return Finding("space", "wrong", text, "make room, or set storage.data_dir")
    if free_bytes < 10 * needed_bytes:
        return Finding("space", "note", text, "make room soon")
    return Finding("space", "ok", text)


def free_bytes(folder: Path) -> int:
    """Room where the folder is, or will be."""
    return shutil.disk_usage(_existing(folder)).free


def needed_bytes_per_s(config: LoadedConfig) -> float:
    """What the camera makes at most."""
    camera, sweep = config.rig.camera, config.rig.sweep
    depth = 2 if config.rig.simulation.bit_depth > 8 else 1
    return camera.width * camera.height * depth * min(sweep.max_rate_hz, 1000.0 / camera.exposure_ms)


def check_speed(folder: Path, needed_per_s: float) -> Finding:
    """The disk takes what the camera makes (a slower one makes the stage wait; it loses nothing)."""
    place = _existing(folder)
    if not os.access(place, os.W_OK):
        return Finding("disk speed", "note", f"{place} is not yours to write: not measured", "")
    written_per_s = measure_disk(place)
    text = f"{written_per_s / 1e6:.0f} MB/s to the disk, the camera makes {needed_per_s / 1e6:.0f} MB/s at most"
    if written_per_s < needed_per_s:
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


def check_clock(now: datetime, set_by_network: bool | None) -> Finding:
    """The date is believable: scans are named by it.

    Args:
        now: what the clock says.
        set_by_network: None: nobody knows.
    """
    if now.year < OLDEST_YEAR:
        return Finding("clock", "wrong", f"the clock says {now:%Y-%m-%d}", "set it: sudo timedatectl set-ntp true")
    if set_by_network is False:
        return Finding("clock", "note", "the clock is not set by the network", "sudo timedatectl set-ntp true")
    return Finding("clock", "ok", f"{now:%Y-%m-%d %H:%M} UTC")


def clock_set_by_network() -> bool | None:
    """What timedatectl says; None where it cannot be asked."""
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


def _existing(path: Path) -> Path:
    while not path.exists():
        path = path.parent
    return path
