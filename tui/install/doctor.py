"""`sweepscope doctor`: runs all checks of machine, devices, calibration, services and network."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from acquire.contract.calibration import Validity, load_calibration
from acquire.contract.config.load import LoadedConfig, home_resolved
from acquire.contract.errors import CalibrationError, ConfigError, NoServiceError, SweepscopeError
from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import client_run_dir
from tui.install.checks import (
    DoctorFinding,
    check_camera,
    check_clock,
    check_firmware,
    check_groups,
    check_python,
    check_space,
    check_speed,
    check_stage,
    clock_set_by_network,
    free_bytes,
    needed_bytes_per_s,
    scan_bytes,
    this_login,
    utc_now,
)
from tui.install.paths import machine_paths

CALIBRATION_DAYS = 90


@dataclass(frozen=True)
class KeyFacts:
    """Keys of the remote access over TCP."""

    server_key: Path
    """File of the rig's key; it may be missing."""
    allowed: Callable[[], int]
    """Number of keys that may connect (raises ConfigError: the list cannot be read)."""


def examine(config: LoadedConfig, status: Callable[[], Status], keys: KeyFacts) -> Iterator[DoctorFinding]:
    """All checks, in the order in which problems should be fixed.

    Args:
        config: the effective configuration.
        status: asks the running daemon (raises SweepscopeError).
        keys: keys of the remote access over TCP.
    """
    now, silence = _ask(status)
    rig, data_dir = config.rig, config.data_dir
    checks: tuple[tuple[str, Callable[[], DoctorFinding]], ...] = (
        ("python", check_python),
        ("groups", lambda: check_groups(this_login(), installed=machine_paths().manifest.exists())),
        ("stage", lambda: check_stage(rig.stage)),
        ("firmware", lambda: check_firmware(rig.stage, now)),
        ("camera", lambda: check_camera(rig.camera, now)),
        ("space", lambda: check_space(data_dir, free_bytes(data_dir), scan_bytes(config))),
        ("disk speed", lambda: check_speed(data_dir, needed_bytes_per_s(config))),
        ("calibration", lambda: check_calibration(rig.reconstruct.calibration, rig.camera.kind, utc_now())),
        ("clock", lambda: check_clock(utc_now(), clock_set_by_network())),
        ("sockets", lambda: check_sockets(client_run_dir)),
        ("services", lambda: check_services(now, silence)),
        ("network", lambda: check_network(rig.network.host, rig.viewer.host, keys)),
    )
    for name, check in checks:
        try:
            yield check()
        except (OSError, SweepscopeError) as error:
            yield DoctorFinding(name, "wrong", str(error), "this should be readable: look at its permissions")


def _ask(status: Callable[[], Status]) -> tuple[Status | None, str]:
    try:
        return status(), ""
    except SweepscopeError as error:
        return None, str(error)


def check_calibration(name: str, camera_kind: str, now: datetime) -> DoctorFinding:
    """The calibration exists, can be read, and is not too old."""
    if not name:
        if camera_kind == "simulated":
            return DoctorFinding("calibration", "ok", "built into the simulated rig")
        return DoctorFinding("calibration", "note", "none: maps, no cloud", "set reconstruct.calibration")
    try:
        path = home_resolved(name, "reconstruct.calibration")
        calibration, _ = load_calibration(path)
        age_days = _age_days(calibration.valid_for, path, now)
    except (CalibrationError, ConfigError, OSError, ValueError) as error:
        return DoctorFinding(
            "calibration", "wrong", str(error), "set reconstruct.calibration to a calibration, or calibrate"
        )
    limit_days = (calibration.valid_for and calibration.valid_for.days) or CALIBRATION_DAYS
    text = f"{path} is {age_days:.0f} days old"
    if age_days > limit_days:
        return DoctorFinding("calibration", "note", text, "calibrate again, or try 'sweepscope calibrate check'")
    return DoctorFinding("calibration", "ok", text)


def _age_days(validity: Validity | None, path: Path, now: datetime) -> float:
    created = validity.created_utc if validity is not None else None
    moment = datetime.fromisoformat(created) if created else datetime.fromtimestamp(path.stat().st_mtime, UTC)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return (now - moment).total_seconds() / 86_400


def check_sockets(find: Callable[[], Path]) -> DoctorFinding:
    """The folder of the sockets exists and is closed to other users.

    Args:
        find: the folder in which a daemon listens (raises NoServiceError).
    """
    try:
        folder = find()
    except NoServiceError as error:
        return DoctorFinding(
            "sockets", "wrong", str(error), "sudo systemctl start sweepscope.target, or 'sweepscope up'"
        )
    mode = stat.S_IMODE(folder.stat().st_mode)
    if mode & 0o007:
        return DoctorFinding("sockets", "wrong", f"{folder} is open to all users", f"chmod o= {folder}")
    return DoctorFinding("sockets", "ok", f"{folder}, mode {mode:04o}")


def check_services(now: Status | None, silence: str) -> DoctorFinding:
    """The daemon answers, the writer is connected, and no fault is unacknowledged."""
    if now is None:
        return DoctorFinding("services", "wrong", silence, "see 'sweepscope logs --service daemon'")
    text = f"daemon {now.state}, {now.stage_kind} stage, {now.camera_kind} camera"
    if not now.writer_alive:
        return DoctorFinding(
            "services", "wrong", f"{text}; the writer is away", "see 'sweepscope logs --service writer'"
        )
    faults = ", ".join(sorted({fault.code for fault in now.faults if not fault.acknowledged}))
    if faults:
        return DoctorFinding("services", "note", f"{text}; faults {faults}", "the console shows what to do about each")
    return DoctorFinding("services", "ok", text)


def check_network(host: str, page_host: str, keys: KeyFacts) -> DoctorFinding:
    """Remote access, where it is configured, has a private key, and at least one key may connect."""
    page = "" if page_host in ("127.0.0.1", "::1", "localhost") else f"; the page is open to view at {page_host}"
    if not host:
        return DoctorFinding("network", "note" if page else "ok", f"no remote access is offered{page}")
    if not keys.server_key.exists():
        fix = "sudo sweepscope keys make --server (or empty network.host)"
        return DoctorFinding("network", "wrong", f"offered at {host}, but there is no key {keys.server_key}", fix)
    if stat.S_IMODE(keys.server_key.stat().st_mode) & 0o077:
        fix = f"chmod 600 {keys.server_key}, and make a new one: others may have read it"
        return DoctorFinding("network", "wrong", f"{keys.server_key} can be read by others", fix)
    count = keys.allowed()
    if not count:
        fix = "sudo sweepscope keys allow NAME KEY"
        return DoctorFinding("network", "note", f"offered at {host}, but no key may connect{page}", fix)
    return DoctorFinding("network", "ok", f"offered at {host} to {count} key{'s' * (count > 1)}{page}")
