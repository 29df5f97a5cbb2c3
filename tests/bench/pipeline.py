"""Measures the whole path of a frame: publisher -> writer (committed) and worker (folded), with the real processes."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np
import zmq
from numpy.typing import NDArray

from tests.bench.publisher import Marks, Publisher
from tui.processes.supervisor import own_command

FRAMES_BYTES: Final = 600_000_000
"""Memory for frames made beforehand; a sweep that needs more repeats each of its frames."""
SERVICES: Final = ("writer", "worker")


def bench_pipeline(
    frames: int = 527, shape: tuple[int, int] = (768, 1024), *, pictures: bool = False
) -> dict[str, Any]:
    """Push one sweep through a writer and a worker as fast as they take it.

    Args:
        frames: length of the sweep, at least 2.
        shape: (height, width) of its 8-bit frames.
        pictures: a subscriber takes preview pictures meanwhile, as a console does.

    Returns:
        frames per second until all are committed and folded, as ``ratio`` to memcpy over the same frames in the same
        run; what came over the live lane and from the file; the times until sealed and until results are on disk.

    Raises:
        SweepscopeError: a service did not come up, did not finish in time, or something was lost.
    """
    ring = make_sweep(shape, frames)
    copy_ns = _memcpy_ns(ring)
    with _place() as place, _services(place, shape) as pids:
        context: zmq.Context[Any] = zmq.Context()
        publisher = Publisher(context, place, ring, frames, pids, pictures=pictures)
        try:
            marks = publisher.run()
        finally:
            context.destroy(linger=0)
    made = publisher.preview.counters["pictures"]
    shown = {"pictures": made, "picture_ms": marks.pictures_ns / 1e6 / made} if made else {}
    return _figures(marks, frames, shape, copy_ns) | shown


def make_sweep(shape: tuple[int, int], frames: int) -> NDArray[np.uint8]:
    """Frames of a sweep over a lit tenth of a dark noisy ground, [m, h, w]; m < ``frames`` where memory is short."""
    height, width = shape
    count = min(frames, max(2, FRAMES_BYTES // (height * width)))
    rng = np.random.default_rng(11)
    noise = rng.integers(8, 16, (8, height, width), dtype=np.uint8)
    rows, columns = max(1, round(height * 0.316)), max(1, round(width * 0.316))
    crossing = (np.linspace(0.1, 0.8, columns)[None] + np.linspace(0, 0.1, rows)[:, None]).astype(np.float32) * count
    amplitude = rng.uniform(80, 220, (rows, columns)).astype(np.float32)
    ring = np.empty((count, height, width), dtype=np.uint8)
    for index in range(count):
        ring[index] = noise[index % len(noise)]
        light = amplitude * np.clip((index - crossing) / 8 + 0.5, 0, 1)
        ring[index, :rows, :columns] += light.astype(np.uint8)
    return ring


def _memcpy_ns(ring: NDArray[np.uint8]) -> float:
    target = np.zeros_like(ring[0])
    begin = time.perf_counter_ns()
    for frame in ring:
        np.copyto(target, frame)
    return (time.perf_counter_ns() - begin) / len(ring)


@contextmanager
def _place() -> Iterator[Path]:
    """A temporary folder for sockets and scan, short enough for a socket path."""
    place = Path(tempfile.mkdtemp(prefix="sweepscope-bench-"))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


@contextmanager
def _services(place: Path, shape: tuple[int, int]) -> Iterator[dict[str, int]]:
    """Run writer and worker while inside; yields their pids by name."""
    settings = {"STORAGE__DATA_DIR": str(place), "CAMERA__HEIGHT": str(shape[0]), "CAMERA__WIDTH": str(shape[1])}
    environ = {**os.environ, "SWEEPSCOPE_RUN": str(place), **{f"SWEEPSCOPE_{key}": settings[key] for key in settings}}
    children: list[subprocess.Popen[bytes]] = []
    try:
        for name in SERVICES:
            with (place / f"{name}.log").open("wb") as log:
                children.append(subprocess.Popen(own_command(name), env=environ, stdout=log, stderr=log))
        yield {name: child.pid for name, child in zip(SERVICES, children, strict=True)}
    finally:
        for child in children:
            child.terminate()
        for child in children:
            try:
                child.wait(10)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()


def _figures(marks: Marks, frames: int, shape: tuple[int, int], copy_ns: float) -> dict[str, Any]:
    begin, frame_ns = marks.begin_ns, (max(marks.committed_ns, marks.folded_ns) - marks.begin_ns) / frames
    return {
        "frames": frames,
        "height": shape[0],
        "width": shape[1],
        "memcpy_ms": copy_ns / 1e6,
        "frame_ms": frame_ns / 1e6,
        "ratio": frame_ns / copy_ns,
        "frames_per_s": 1e9 / frame_ns,
        "sent_per_s": frames * 1e9 / (marks.sent_ns - begin),
        "committed_per_s": frames * 1e9 / (marks.committed_ns - begin),
        "folded_per_s": frames * 1e9 / (marks.folded_ns - begin),
        **marks.counts,
        "live_unsent": marks.live_unsent,
        "sealed_after_last_commit_s": (marks.sealed_ns - marks.committed_ns) / 1e9,
        "results_after_last_fold_s": (marks.results_ns - marks.folded_ns) / 1e9,
        "worker_cpu_ms_per_frame": {what: seconds * 1e3 / frames for what, seconds in marks.worker_s.items()},
        "cpu_ms_per_frame": {name: seconds * 1e3 / frames for name, seconds in marks.cpu_s.items()},
        "cores": os.cpu_count(),
    }
