"""`sweepscope up`: runs the four services as child processes, restarts them, and ends them all."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType

from acquire.contract.config.load import LoadedConfig
from acquire.contract.errors import EXIT_FAILED, AlreadyRunningError
from acquire.contract.process.run_dir import is_served
from tui.processes.supervisor import POLL_S, ServiceSpec, Supervisor, own_command

SERVICES = ("daemon", "writer", "worker", "viewer")
VITAL = ("daemon", "writer")
"""No scan is possible without these: when one is given up, all are ended."""
URL_NAME = "viewer.url"


def service_specs(config_path: str | None, *, remote: bool = False) -> list[ServiceSpec]:
    """The four services, the daemon first; with ``remote`` also the gateway for other machines."""
    names = (*SERVICES, "gateway") if remote else SERVICES
    return [ServiceSpec(name, own_command(name, config_path=config_path)) for name in names]


def read_url(run_dir: Path) -> str:
    """Address of the viewer's page; empty if there is none yet."""
    with suppress(OSError, UnicodeDecodeError):
        return (run_dir / URL_NAME).read_text(encoding="utf-8").strip()
    return ""


@contextmanager
def signals_set(event: threading.Event) -> Iterator[list[int]]:
    """While inside, SIGTERM, SIGINT and SIGHUP only set ``event``; yields the list of received signals."""
    came: list[int] = []

    def note(number: int, _frame: FrameType | None) -> None:
        came.append(number)
        event.set()

    watched = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
    before = {number: signal.signal(number, note) for number in watched}
    try:
        yield came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def say(text: str) -> None:
    """Print a line on stdout, at once."""
    print(text, flush=True)


def run_up(config: LoadedConfig, config_path: str | None, run_dir: Path) -> int:
    """Run until a signal arrives; returns the exit status.

    Raises:
        AlreadyRunningError: a daemon already runs in ``run_dir``.
    """
    if is_served(run_dir):
        raise AlreadyRunningError(f"a daemon already runs in {run_dir}: stop it first, or set SWEEPSCOPE_RUN")
    (run_dir / URL_NAME).unlink(missing_ok=True)
    absolute = str(Path(config_path).resolve()) if config_path else None
    supervisor = Supervisor(
        service_specs(absolute, remote=bool(config.rig.network.host)),
        child_environment(run_dir),
        _complain,
        final_refusals=frozenset({"daemon"}),  # a device that is not there
    )
    wake = threading.Event()
    with signals_set(wake) as came:
        supervisor.start()
        try:
            say(f"daemon, writer, worker and viewer run in {run_dir}; Ctrl-C ends them")
            status = _tend_until(wake, supervisor, run_dir)
        finally:
            supervisor.stop(config.rig.limits.stop_s + 1.0)
    return status if not came else 0


def _tend_until(wake: threading.Event, supervisor: Supervisor, run_dir: Path) -> int:
    shown = ""
    while not wake.wait(POLL_S):
        supervisor.tend()
        if (url := read_url(run_dir)) not in ("", shown):  # a restarted viewer has another address
            shown = url
            say(f"the cloud is shown at {url}")
        lost = [name for name in supervisor.given_up if name in VITAL]
        if lost:
            _complain(f"{lost[0]} cannot be kept running, so all is ended; scans on disk are safe")
            return EXIT_FAILED
    return 0


def child_environment(run_dir: Path, environ: Mapping[str, str] = os.environ) -> dict[str, str]:
    """The environment of the services: ours, with the directory of the sockets."""
    return {**environ, "SWEEPSCOPE_RUN": str(run_dir), "PYTHONUNBUFFERED": "1"}


def _complain(text: str) -> None:
    print(f"sweepscope up: {text}", file=sys.stderr, flush=True)
