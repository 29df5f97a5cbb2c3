"""A fake camera with loss, damage and doubles in front of writer, worker and viewer: three services, one truth."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np
import pytest

from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.fakes.processes.launch import Bench, bench_at
from tests.system.viewer.test_browser import ARGUMENTS
from tests.system.writer.test_writer import assert_file_equals_witness
from tests.waiting import WALL_CLOCK_S, wait_for

FRAMES = 120


@pytest.fixture
def bench(run_dir: Path, tmp_path: Path) -> Iterator[Bench]:
    with bench_at(run_dir, tmp_path) as made:
        yield made


def service(bench: Bench, name: str) -> None:
    bench.start(name, ["-m", "tui.cli", name], RUN=bench.run_dir, VIEWER__PORT=0)


def report_of(bench: Bench) -> dict:
    path = bench.scan / "report.json"
    return wait_for(lambda: path.exists() and json.loads(path.read_text()), "the report")


def assert_live_equals_reconstruct(bench: Bench, tmp_path: Path) -> None:
    reconstruct(bench.scan, ReconstructOptions(out=tmp_path / "again"))
    with h5py.File(bench.scan / "maps.h5") as live, h5py.File(tmp_path / "again/maps.h5") as again:
        for name in (name for name in again if isinstance(again[name], h5py.Dataset)):
            assert np.array_equal(live[name][()], again[name][()], equal_nan=live[name].dtype.kind == "f"), name


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_whatever_the_live_lane_loses_the_worker_ends_with_what_the_file_holds(bench: Bench, tmp_path: Path, loss):
    service(bench, "worker")
    bench.writer()
    bench.camera(FRAMES, loss=loss, bad=0.05, duplicate=0.1, delay_ms=4, seed=3, stay=1).result(stays=True)
    assert_file_equals_witness(bench, FRAMES, seed=3)
    counts = report_of(bench)["counts"]
    assert counts["frames"] == FRAMES and counts["from_live"] + counts["from_file"] == FRAMES
    if loss:
        assert counts["from_file"] >= 0.1 * FRAMES
    assert_live_equals_reconstruct(bench, tmp_path)


@pytest.mark.shares_processes
def test_the_page_follows_a_sweep_of_the_fake_camera_to_its_end(bench: Bench, chromium: str) -> None:
    from playwright.sync_api import sync_playwright

    for name in ("worker", "viewer"):
        service(bench, name)
    bench.writer()
    address = bench.run_dir / "viewer.url"
    wait_for(lambda: address.exists() and address.read_text().strip(), "the page's address")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        page = browser.new_page()
        page.set_default_timeout(WALL_CLOCK_S * 1000)
        page.goto(address.read_text().strip())
        camera = bench.camera(FRAMES, loss=0.05, delay_ms=20, stay=1)
        page.get_by_text(f"{FRAMES} of {FRAMES}").first.wait_for()
        camera.result(stays=True)
        browser.close()
