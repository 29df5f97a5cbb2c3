"""Owns the services of an installation as they run: restarts them, waits until they are ready, sees what they do."""

from __future__ import annotations

import time

from acquire.contract.errors import SweepscopeError
from acquire.contract.process.run_dir import SYSTEM_RUN, service_run_dir
from acquire.contract.states import State
from tui.client.rig_client import RigClient
from tui.install.machine import InstallError, systemctl
from tui.install.paths import SERVICES, TARGET, Places

ASK_S = 3.0
FAILED_STARTS = 3
"""A service that ended so often while it was awaited does not start."""
START_S = 200.0
"""The new services have so long to be ready: the first start compiles kernels."""


def refuse_during_a_sweep(places: Places) -> None:
    """Changing the program restarts the daemon, and that ends a sweep.

    Raises:
        InstallError: one is running.
    """
    try:
        run_dir = SYSTEM_RUN if not places.user else service_run_dir()
        with RigClient(run_dir, timeout_s=ASK_S) as client:
            now = client.status()
    except SweepscopeError:
        return  # nothing runs that could be disturbed
    if now.state in (State.ARMED, State.SWEEPING, State.HOLDING, State.FINISHING):
        raise InstallError(
            f"a sweep is running ({now.committed} of {now.expected} frames): wait for its end, or 'sweepscope stop'"
        )


def restart(*, user: bool) -> None:
    """Stop everything, start it, and wait until it is ready; a service that keeps failing is noticed at once.

    Raises:
        InstallError: one of them is not ready in time; it is named.
    """
    systemctl("stop", TARGET, "sweepscope-*.service", user=user)
    before = _look(user=user)  # systemd counts restarts from the machine's start
    systemctl("start", "--no-block", TARGET, user=user)
    end_s = time.monotonic() + START_S
    while True:
        now = _look(user=user)
        if all(state == "active" for state, _ in now.values()):
            return
        stuck = [unit for unit, (_, restarts) in now.items() if restarts - before[unit][1] >= FAILED_STARTS]
        if not stuck and time.monotonic() > end_s:
            stuck = [unit for unit, (state, _) in now.items() if state != "active"]
        if stuck:
            raise InstallError(f"{', '.join(stuck)} does not get ready: see 'journalctl -u {stuck[0]}'")
        time.sleep(0.2)


def _look(*, user: bool) -> dict[str, tuple[str, int]]:
    """State and number of restarts of each service."""
    found = {}
    for unit in (f"sweepscope-{service}.service" for service in SERVICES):
        said = systemctl("show", "--property=ActiveState,NRestarts", unit, user=user)
        facts = dict(line.split("=", 1) for line in said.splitlines() if "=" in line)
        found[unit] = (facts.get("ActiveState", ""), int(facts.get("NRestarts") or 0))
    return found
