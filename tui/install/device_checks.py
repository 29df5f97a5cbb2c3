"""Looks whether stage and camera are there, may be opened, and carry the firmware that this program speaks to."""

from __future__ import annotations

import os
from pathlib import Path

from acquire.contract.config.model import CameraConfig, StageConfig
from acquire.contract.messaging.messages import Status
from tui.install.finding import Finding

DEV = Path("/dev")


def serial_ports(dev: Path = DEV) -> list[str]:
    """Serial ports of USB devices, the stable names first."""
    stable = [dev / "sweepscope-stage", *sorted((dev / "serial/by-id").glob("*"))]
    found = [path for path in stable if path.exists()]
    return [str(path) for path in found or sorted([*dev.glob("ttyACM*"), *dev.glob("ttyUSB*")])]


def cameras(dev: Path = DEV) -> list[str]:
    """Video devices by their stable names."""
    found = sorted((dev / "v4l/by-id").glob("*-index0")) or sorted(dev.glob("video*"))
    return [str(path) for path in found]


def check_stage(stage: StageConfig, dev: Path = DEV) -> Finding:
    """The controller's port is there and may be opened."""
    if stage.kind == "simulated" or stage.port == "emulator":
        return Finding("stage", "ok", "simulated" if stage.kind == "simulated" else "the emulated controller")
    found = serial_ports(dev)
    port = stage.port or next(iter(found), "")
    if not port:
        return Finding("stage", "wrong", "no serial port is there", "plug the controller in, or set stage.port")
    if not stage.port and len(found) > 1:
        mend = "set stage.port in rig.toml to the controller's"
        return Finding("stage", "wrong", f"more than one serial port is there: {', '.join(found)}", mend)
    if not Path(port).exists():
        others = ", ".join(found) or "none"
        return Finding("stage", "wrong", f"{port} is not there (found: {others})", "set stage.port in rig.toml")
    return _may_open("stage", port) or Finding("stage", "ok", f"{stage.kind} on {port}")


def check_camera(camera: CameraConfig, status: Status | None, dev: Path = DEV) -> Finding:
    """The camera is there and may be opened; one that the daemon has open is fine."""
    if camera.kind == "simulated":
        return Finding("camera", "ok", camera.kind)
    if status is not None and status.camera_kind == camera.kind:
        return Finding("camera", "ok", f"the daemon has the {camera.kind} camera open")
    if camera.kind == "uvc":
        found = cameras(dev)
        if not found:
            return Finding("camera", "wrong", "no video device is there", "plug the camera in")
        return _may_open("camera", found[0]) or Finding("camera", "ok", f"{camera.kind}: {', '.join(found)}")
    if status is not None:
        text = f"the configuration asks for a {camera.kind} camera, the daemon runs a {status.camera_kind} one"
        return Finding("camera", "wrong", text, "restart the daemon: sudo systemctl restart sweepscope-daemon")
    return Finding("camera", "note", f"{camera.kind}: it can be seen only by a daemon that runs", "start the services")


def check_firmware(stage: StageConfig, status: Status | None) -> Finding:
    """The version of the firmware; with one that this program cannot speak to the daemon does not start."""
    if status is None:
        if stage.kind == "simulated":
            return Finding("firmware", "ok", "none: the stage is simulated")
        mend = "start the services; if the daemon refuses the firmware: make -C firmware flash PORT=..."
        return Finding("firmware", "note", "not known: no daemon answers", mend)
    if status.stage_kind == "simulated":
        return Finding("firmware", "ok", "none: the stage is simulated")
    if not status.stage_version:
        return Finding("firmware", "note", f"the {status.stage_kind} controller does not say its version")
    if status.stage_kind == "legacy":
        mend = "flash ours when the wiring allows: it counts positions and triggers (docs/wiring.md)"
        return Finding("firmware", "note", status.stage_version, mend)
    return Finding("firmware", "ok", f"version {status.stage_version}")


def _may_open(name: str, device: str) -> Finding | None:
    if os.access(device, os.R_OK | os.W_OK):
        return None
    try:
        mend = f"join the group {Path(device).group()}: sudo usermod -aG {Path(device).group()} $USER; log in again"
    except (KeyError, OSError):
        mend = "look at its permissions: sudo sweepscope install puts the rules for devices in place"
    return Finding(name, "wrong", f"{device} may not be opened", mend)
