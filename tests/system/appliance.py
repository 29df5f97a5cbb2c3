"""Runs the real services as processes of their own, kills them, starts them again, and speaks to them as a client."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from acquire.contract.messaging.messages import Status
from acquire.contract.process.run_dir import is_served
from tests.waiting import DEADLINE_S, exit_status, wait_for
from tui.client.rig_client import RigClient

SMALL = {
    "CAMERA__WIDTH": 128,
    "CAMERA__HEIGHT": 96,
    "SIMULATION__TIME_SCALE": 0.001,
    "SWEEP__MAX_RATE_HZ": 1000.0,
    "SWEEP__STEPS_PER_FRAME": 12,
    "VIEWER__PORT": 0,
}
"""132 frames of 128 x 96 as fast as the machine allows."""


class Appliance:
    """Services on a private run directory; ``settings`` are SECTION__KEY -> value."""

    def __init__(self, run_dir: Path, data_dir: Path, **settings: Any) -> None:
        self.run_dir, self.data_dir = run_dir, data_dir
        known = SMALL | {"STORAGE__DATA_DIR": data_dir} | settings
        variables = {f"SWEEPSCOPE_{name}": str(value) for name, value in known.items()}
        self.environ = {**os.environ, **variables, "SWEEPSCOPE_RUN": str(run_dir), "PYTHONFAULTHANDLER": "1"}
        self.processes: dict[str, subprocess.Popen[bytes]] = {}
        self.log = run_dir / "services.log"

    def start(self, *services: str) -> None:
        """Start services that are not running; returns when they do, not when they are ready."""
        for service in services:
            with self.log.open("ab") as log:
                self.processes[service] = subprocess.Popen(
                    [sys.executable, "-m", "tui.cli", service], env=self.environ, stdout=log, stderr=log
                )

    def send_signal(self, service: str, number: int) -> None:
        """Send a signal to a service."""
        self.processes[service].send_signal(number)

    def kill(self, service: str) -> None:
        """SIGKILL, and wait until it is gone."""
        process = self.processes.pop(service)
        process.kill()
        exit_status(process)

    def end(self, service: str, number: int = signal.SIGTERM) -> int:
        """Tell a service to end; returns its exit status."""
        process = self.processes.pop(service)
        process.send_signal(number)
        return exit_status(process)

    def close(self) -> None:
        """Kill whatever still runs."""
        for service in list(self.processes):
            self.kill(service)

    def client(self) -> RigClient:
        """A client, once the daemon answers."""
        self.until(lambda: is_served(self.run_dir), "the daemon binds")  # noqa: PLW0108
        return RigClient(self.run_dir, timeout_s=DEADLINE_S)

    def until(self, condition: Callable[[], Any], what: str, deadline_s: float = DEADLINE_S) -> Any:
        """Wait for something with a deadline; the services' log is shown when it does not come."""
        return wait_for(condition, what, deadline_s, why=self._newest_log)

    def _newest_log(self) -> str:
        return self.log.read_text(errors="replace")[-4000:] if self.log.exists() else ""

    def until_status(self, client: RigClient, wanted: Callable[[Status], Any], what: str) -> Status:
        """Wait for a status that is as wanted."""

        def seen() -> Status | None:
            status = client.newest_status(0.2)
            return status if status is not None and wanted(status) else None

        return self.until(seen, what)

    def scan(self, client: RigClient, **args: Any) -> dict[str, Any]:
        """Start a scan; returns the reply's result."""
        return client.request("scan", **({"name": "test"} | args)).result

    def finished(self, client: RigClient, scan_uid: str) -> Status:
        """Wait until a scan has ended."""
        return self.until_status(
            client,
            lambda s: s.scan_uid == scan_uid and s.state == "idle" and s.outcome not in ("", "running"),
            "the scan ends",
        )
