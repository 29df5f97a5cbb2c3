"""The rig of the demonstration: simulated devices, own configuration, own sockets, a free port for the page."""

from __future__ import annotations

import os
import shutil
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import tomli_w

from acquire.contract.config.load import load_config
from acquire.contract.config.model import SweepConfig
from acquire.contract.errors import ConfigError, SweepscopeError
from acquire.contract.process.run_dir import temporary_run_dir
from tui.processes.all_services import VITAL, child_environment, service_specs
from tui.processes.supervisor import POLL_S, Supervisor

LOG_TAIL_LINES = 3


@dataclass(frozen=True)
class DemoOptions:
    """Settings of the demonstration; None keeps the default."""

    size: tuple[int, int] | None = None
    """Width and height of the camera in pixels."""
    frames: int | None = None
    """Frames over the whole default travel."""
    time_scale: float | None = None
    """Factor on simulated durations."""
    specimen: str | None = None
    seed: int | None = None
    max_rate_hz: float | None = None
    data_dir: Path = Path("demo-data")
    twin: bool = False
    """Run the real firmware in an emulator instead of the simulated stage."""

    def settings(self) -> dict[str, dict[str, Any]]:
        """rig.toml: only the keys that differ from their default."""
        width, height = self.size or (None, None)
        wanted: dict[str, dict[str, Any]] = {
            "storage": {"data_dir": str(self.data_dir.resolve())},
            "camera": {"kind": "simulated", "width": width, "height": height},
            "stage": {"kind": "uno", "port": "emulator"} if self.twin else {"kind": "simulated"},
            "sweep": {**self._sweep(), "max_rate_hz": self.max_rate_hz},
            "simulation": {"object": self.specimen, "seed": self.seed, "time_scale": self.time_scale},
            "viewer": {"port": 0},
        }
        return {name: {k: v for k, v in keys.items() if v is not None} for name, keys in wanted.items()}

    def _sweep(self) -> dict[str, int]:
        if self.frames is None:
            return {}
        travel = SweepConfig()
        pitch = max(1, (travel.last_steps - travel.first_steps) // (self.frames - 1))
        return {"steps_per_frame": pitch, "last_steps": travel.first_steps + pitch * (self.frames - 1)}


class DemoRig:
    """The four services, kept running by a thread. A context manager: leaving it ends them, the daemon first."""

    def __init__(
        self, options: DemoOptions, say: Callable[[str], None], environ: Mapping[str, str] = os.environ
    ) -> None:
        """Create the directories and the configuration; nothing runs before ``with``.

        Raises:
            ConfigError: a setting out of bounds, or a folder that cannot be created.
        """
        self.data_dir = options.data_dir.resolve()
        self._log_dir = self.data_dir / "logs"
        try:
            self._log_dir.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(f"cannot create {self._log_dir}: {error.strerror}; use another folder") from None
        self.run_dir = temporary_run_dir()
        path = self.run_dir / "rig.toml"
        path.write_text(tomli_w.dumps(options.settings()), encoding="utf-8")
        try:
            self.config = load_config(str(path), environ={})
        except SweepscopeError:
            shutil.rmtree(self.run_dir, ignore_errors=True)
            raise
        # variables of the user's own rig must not reach the services
        clean = {name: value for name, value in environ.items() if not name.startswith("SWEEPSCOPE_")}
        self.supervisor = Supervisor(
            service_specs(str(path)), child_environment(self.run_dir, clean), say, log_dir=self._log_dir
        )
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._tend, name="demo-services", daemon=True)

    def __enter__(self) -> Self:
        for log in self._log_dir.glob("*.log"):
            log.unlink()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join()
        shutil.rmtree(self.run_dir, ignore_errors=True)

    def _tend(self) -> None:
        self.supervisor.start()
        while not self._ending.wait(POLL_S):
            self.supervisor.tend()
        self.supervisor.stop(self.config.rig.limits.stop_s + 1.0)

    def check(self, names: tuple[str, ...] = VITAL) -> None:
        """Raise SweepscopeError, with the last lines of its log, if one of the services ``names`` was given up."""
        for name in self.supervisor.given_up:
            if name in names:
                raise SweepscopeError(f"the {name} cannot be kept running: {self._last_words(name)}")

    def _last_words(self, name: str) -> str:
        log = self._log_dir / f"{name}.log"
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.is_file() else []
        return f"{' | '.join(lines[-LOG_TAIL_LINES:]) or 'it logged nothing'} (see {log})"
