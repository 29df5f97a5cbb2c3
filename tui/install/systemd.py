"""The services of an installation under systemd: makes their unit files, restarts them, waits until they are ready."""

from __future__ import annotations

import os
import re
import time
from pathlib import Path

from acquire.contract.errors import SweepscopeError
from acquire.contract.process.run_dir import SYSTEM_RUN, service_run_dir
from acquire.contract.states import State
from tui.client.rig_client import RigClient
from tui.install.machine import InstallError, run
from tui.install.paths import InstallPaths

UNIT_PROGRAM = "/opt/sweepscope/current/bin/sweepscope"
UNIT_CONFIG = "/etc/sweepscope/rig.toml"
"""Program and configuration as the unit files of the source tree name them."""
TARGET = "sweepscope.target"
ALL_SERVICES = "sweepscope-*.service"
SERVICES = tuple(f"sweepscope-{name}.service" for name in ("daemon", "writer", "worker", "viewer"))
ASK_S = 3.0
FAILED_STARTS = 3
"""A service that ended so often while we waited for it does not start."""
START_S = 600.0
"""Longest wait until the new services are ready: the first start compiles kernels, for minutes on a slow machine (each
restart goes on with what was compiled). A service that cannot start is noticed by its restarts."""
_MACHINE_ONLY = re.compile(r"\n# -+ for the machine only.*?(?=\n\[|\Z)", re.DOTALL)


def unit_text(text: str, paths: InstallPaths, data_dir: str) -> str:
    """A unit file of the source tree, adapted to an installation.

    Args:
        text: the unit file as it stands in the source tree.
        paths: where the program goes.
        data_dir: folder of all scans; one outside /var/lib/sweepscope is made writable for the services.
    """
    text = text.replace(UNIT_PROGRAM, str(paths.current / "bin/sweepscope")).replace(UNIT_CONFIG, str(paths.config))
    if paths.user:
        return _MACHINE_ONLY.sub("", text).replace("WantedBy=multi-user.target", "WantedBy=default.target")
    if data_dir.startswith("/var/lib/sweepscope/"):
        return text
    home = "ProtectHome=yes"
    if data_dir.startswith(("/home/", "/root/", "/run/user/")):
        home = f"ProtectHome=tmpfs\nBindPaths={data_dir}"  # this folder is visible, the rest of /home is empty
    return text.replace("ProtectHome=yes", f"{home}\nReadWritePaths={data_dir}")


def systemd_runs(*, user: bool) -> bool:
    """True if a systemd is running that can start services."""
    if not Path("/run/systemd/system").is_dir():
        return False
    return not user or bool(os.environ.get("XDG_RUNTIME_DIR"))


def systemctl(*words: str, user: bool) -> str:
    """Run systemctl (raises InstallError)."""
    return run("systemctl", *(("--user",) if user else ()), *words, timeout_s=300.0)


def refuse_during_a_sweep(paths: InstallPaths) -> None:
    """Check that no sweep runs: changing the program restarts the daemon, and that would end it.

    Raises:
        InstallError: a sweep is running.
    """
    try:
        run_dir = SYSTEM_RUN if not paths.user else service_run_dir()
        with RigClient(run_dir, timeout_s=ASK_S) as client:
            now = client.status()
    except SweepscopeError:
        return  # no daemon answers, so no sweep runs
    if now.state in (State.ARMED, State.SWEEPING, State.HOLDING, State.FINISHING):
        raise InstallError(
            f"a sweep is running ({now.committed} of {now.expected} frames): wait for its end, or 'sweepscope stop'"
        )


def restart(*, user: bool) -> None:
    """Restart all services and wait until they are ready; fails at once when one keeps ending.

    Raises:
        InstallError: a service is not ready in time; the message names it.
    """
    systemctl("stop", TARGET, ALL_SERVICES, user=user)
    before = _states(user=user)  # systemd counts restarts since the boot
    systemctl("start", "--no-block", TARGET, user=user)
    end_s = time.monotonic() + START_S
    while True:
        now = _states(user=user)
        if all(state == "active" for state, _ in now.values()):
            return
        stuck = [unit for unit, (_, restarts) in now.items() if restarts - before[unit][1] >= FAILED_STARTS]
        if not stuck and time.monotonic() > end_s:
            stuck = [unit for unit, (state, _) in now.items() if state != "active"]
        if stuck:
            raise InstallError(f"{', '.join(stuck)} does not get ready: see 'journalctl -u {stuck[0]}'")
        time.sleep(0.2)


def _states(*, user: bool) -> dict[str, tuple[str, int]]:
    """Active state and number of restarts of each service."""
    found = {}
    for unit in SERVICES:
        said = systemctl("show", "--property=ActiveState,NRestarts", unit, user=user)
        facts = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
        found[unit] = (facts.get("ActiveState", ""), int(facts.get("NRestarts") or 0))
    return found
