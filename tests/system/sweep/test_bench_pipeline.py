"""The pipeline's benchmark runs the real processes, loses nothing, and says so in figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from acquire.contract.errors import NoServiceError
from tests.bench import pipeline as bench
from tests.bench import publisher as bench_publisher


def test_a_small_sweep_gets_through_writer_and_worker() -> None:
    figures = bench.bench_pipeline(40, (48, 64))
    assert figures["from_live"] + figures["from_file"] == 40
    assert figures["frames_per_s"] > 0
    assert figures["ratio"] == pytest.approx(figures["frame_ms"] / figures["memcpy_ms"])
    assert figures["worker_cpu_ms_per_frame"]["fold"] > 0 and figures["worker_cpu_ms_per_frame"]["results"] > 0
    assert set(figures["cpu_ms_per_frame"]) == {"publisher", "writer", "worker"}


def test_a_benchmark_without_services_gives_up_in_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "SERVICES", ())
    monkeypatch.setattr(bench_publisher, "READY_S", 0.3)
    with pytest.raises(NoServiceError, match="writer and worker not within"):
        bench.bench_pipeline(4, (48, 64))


def test_nothing_is_left_of_a_benchmark(monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> None:
    monkeypatch.setattr(bench.tempfile, "tempdir", str(run_dir))
    monkeypatch.setattr(bench, "SERVICES", ())
    monkeypatch.setattr(bench_publisher, "READY_S", 0.1)
    with pytest.raises(NoServiceError):
        bench.bench_pipeline(4, (48, 64))
    assert list(run_dir.iterdir()) == []


def test_frames_that_do_not_fit_into_memory_are_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "FRAMES_BYTES", 10 * 48 * 64)
    ring = bench.make_sweep((48, 64), 100)
    assert ring.shape == (10, 48, 64)
    assert np.all(np.diff(ring[:, 4, 10].astype(int))[1:] > -16), "a lit pixel only brightens, but for noise"
