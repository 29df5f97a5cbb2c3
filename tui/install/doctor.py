"""Looks over what people get wrong, and says the mend of each; every check is a function that answers, never raises."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

from acquire.contract.calibration import Validity, load_calibration
from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import CalibrationError, NoServiceError, SweepscopeError
from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import client_run_dir
from tui.install.device_checks import check_camera, check_firmware, check_stage
from tui.install.finding import Finding
from tui.install.host_checks import (
    check_clock,
    check_groups,
    check_python,
    check_space,
    check_speed,
    clock_set_by_network,
    free_bytes,
    needed_bytes_per_s,
    scan_bytes,
    this_login,
    utc_now,
)
from tui.install.paths import machine_places

CALIBRATION_DAYS = 90


@dataclass(frozen=True)
class KeyFacts:
    """What is known of the keys for the way in over TCP."""

    server_key: Path
    """Where the rig's key is, or should be."""
    allowed: Callable[[], int]
    """How many keys are let in (raises ConfigError: the list cannot be read)."""


def examine(config: LoadedConfig, status: Callable[[], Status], keys: KeyFacts) -> Iterator[Finding]:
    """All checks in the order in which they matter.

    Args:
        config: the effective configuration.
        status: asks the running daemon (raises SweepscopeError).
        keys: what is known of the keys for the way in over TCP.
    """
    now, silence = _ask(status)
    rig, data_dir = config.rig, config.data_dir
    checks: tuple[tuple[str, Callable[[], Finding]], ...] = (
        ("python", check_python),
        ("groups", lambda: check_groups(this_login(), installed=machine_places().manifest.exists())),
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
            yield Finding(name, "wrong", str(error), "this should be readable: look at its permissions")


def _ask(status: Callable[[], Status]) -> tuple[Status | None, str]:
    try:
        return status(), ""
    except SweepscopeError as error:
        return None, str(error)


def check_calibration(name: str, camera_kind: str, now: datetime) -> Finding:
    """The calibration is there, readable, and not too old."""
    if not name:
        if camera_kind == "simulated":
            return Finding("calibration", "ok", "the simulated rig knows its own")
        return Finding("calibration", "note", "none: maps, no cloud", "set reconstruct.calibration")
    path = Path(name).expanduser()
    try:
        calibration, _ = load_calibration(path)
        age_days = _age_days(calibration.valid_for, path, now)
    except (CalibrationError, OSError, ValueError) as error:
        return Finding("calibration", "wrong", str(error), "set reconstruct.calibration to a calibration, or calibrate")
    limit_days = (calibration.valid_for and calibration.valid_for.days) or CALIBRATION_DAYS
    text = f"{path} is {age_days:.0f} days old"
    if age_days > limit_days:
        return Finding("calibration", "note", text, "calibrate again, or try 'sweepscope calibrate check'")
    return Finding("calibration", "ok", text)


def _age_days(validity: Validity | None, path: Path, now: datetime) -> float:
    created = validity.created_utc if validity is not None else None
    moment = datetime.fromisoformat(created) if created else datetime.fromtimestamp(path.stat().st_mtime, UTC)
    if moment.tzinfo is None:
        moment = moment.replace(tzinfo=UTC)
    return (now - moment).total_seconds() / 86_400


def check_sockets(find: Callable[[], Path]) -> Finding:
    """The folder of the sockets is there and closed to others.

    Args:
        find: the folder in which a daemon listens (raises NoServiceError).
    """
    try:
        folder = find()
    except NoServiceError as error:
        return Finding("sockets", "wrong", str(error), "sudo systemctl start sweepscope.target, or 'sweepscope up'")
    mode = stat.S_IMODE(folder.stat().st_mode)
    if mode & 0o007:
        return Finding("sockets", "wrong", f"{folder} is open to all users", f"chmod o= {folder}")
    return Finding("sockets", "ok", f"{folder}, mode {mode:04o}")


def check_services(now: Status | None, silence: str) -> Finding:
    """The daemon answers, the writer is with it, and no fault waits to be seen."""
    if now is None:
        return Finding("services", "wrong", silence, "see 'sweepscope logs --service daemon'")
    text = f"daemon {now.state}, {now.stage_kind} stage, {now.camera_kind} camera"
    if not now.writer_alive:
        return Finding("services", "wrong", f"{text}; the writer is away", "see 'sweepscope logs --service writer'")
    faults = ", ".join(sorted({fault.code for fault in now.faults if not fault.acknowledged}))
    if faults:
        return Finding("services", "note", f"{text}; faults {faults}", "the console says what each asks for")
    return Finding("services", "ok", text)


def check_network(host: str, page_host: str, keys: KeyFacts) -> Finding:
    """What is offered to other machines is meant, has a key that nobody else reads, and lets somebody in."""
    page = "" if page_host in ("127.0.0.1", "::1", "localhost") else f"; the page is open to view at {page_host}"
    if not host:
        return Finding("network", "note" if page else "ok", f"no lane is offered to other machines{page}")
    if not keys.server_key.exists():
        mend = "sudo sweepscope keys make --server (or empty network.host)"
        return Finding("network", "wrong", f"offered at {host}, but there is no key {keys.server_key}", mend)
    if stat.S_IMODE(keys.server_key.stat().st_mode) & 0o077:
        mend = f"chmod 600 {keys.server_key}, and make a new one: others may have read it"
        return Finding("network", "wrong", f"{keys.server_key} can be read by others", mend)
    count = keys.allowed()
    if not count:
        mend = "sudo sweepscope keys allow NAME KEY"
        return Finding("network", "note", f"offered at {host}, and nobody is let in{page}", mend)
    return Finding("network", "ok", f"offered at {host} to {count} key{'s' * (count > 1)}{page}")
