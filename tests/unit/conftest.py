"""What tests of the daemon without processes share."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from acquire.contract.process.clocks import Clock

from .rig_in_process import RigInProcess


@pytest.fixture
def start_rig(run_dir: Path, tmp_path: Path) -> Iterator[Callable[..., RigInProcess]]:
    """Start a rig with these settings (dots as double underscores)."""
    rigs: list[RigInProcess] = []

    def call(clock: Clock | None = None, **settings: object) -> RigInProcess:
        dotted = {name.replace("__", "."): value for name, value in settings.items()}
        rigs.append(RigInProcess(run_dir, tmp_path / "scans", dotted, clock=clock).__enter__())
        return rigs[-1]

    yield call
    for rig in rigs:
        rig.__exit__()
