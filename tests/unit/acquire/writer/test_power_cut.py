"""A power cut loses any subset of the writes that were not synced yet, whole or in part; what is durable stays."""

from __future__ import annotations

import os
import random
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from acquire.contract.messaging.messages import Start
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.writer.recover import recover
from acquire.writer.scan_file import ScanFile, create_scan
from acquire.writer.verify import verify
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 24
SECTOR = 512


@dataclass
class LossyDisk:
    """Below ``os.pwrite`` and ``os.fdatasync``: knows what the platter holds, and what only the cache does."""

    platter: bytearray
    cache: list[tuple[int, bytes]] = field(default_factory=list)

    def write(self, offset: int, data: bytes) -> None:
        self.cache.append((offset, data))

    def sync(self) -> None:
        for offset, data in self.cache:
            self.platter[offset : offset + len(data)] = data
        self.cache.clear()

    def after_a_power_cut(self, source: random.Random) -> bytes:
        """The platter, with any subset of the cached writes on it, some of them torn at a sector."""
        image, keep = bytearray(self.platter), source.random()
        for offset, data in source.sample(self.cache, len(self.cache)):
            if source.random() > keep:
                continue
            cut = len(data)
            if source.random() < 0.3:
                first_end = SECTOR - offset % SECTOR
                cut = min(len(data), first_end + SECTOR * source.randrange(1 + len(data) // SECTOR))
            image[offset : offset + cut] = data[:cut]
        return bytes(image)


@pytest.fixture
def on_lossy_disk(monkeypatch: pytest.MonkeyPatch) -> Callable[[Path], LossyDisk]:
    def install(path: Path) -> LossyDisk:
        disk = LossyDisk(bytearray(path.read_bytes()))
        real_write, real_sync, real_fsync = os.pwrite, os.fdatasync, os.fsync

        def pwrite(fd: int, data: bytes, offset: int) -> int:
            disk.write(offset, bytes(data))
            return real_write(fd, data, offset)

        def fdatasync(fd: int) -> None:
            real_sync(fd)
            disk.sync()

        def fsync(fd: int) -> None:
            real_fsync(fd)
            disk.sync()

        monkeypatch.setattr(os, "pwrite", pwrite)
        monkeypatch.setattr(os, "fdatasync", fdatasync)
        monkeypatch.setattr(os, "fsync", fsync)
        return disk

    return install


def put(scan: ScanFile, start: Start, frame_index: int) -> None:
    pixels = pixels_of(frame_index, COUNT, start.format)
    scan.write_frame(image_of(frame_index, pixels, start), pixels)


def assert_exact(folder: Path, start: Start) -> int:
    """Every frame that is called committed is exact, its record too."""
    with ScanReader(folder) as reader:
        present = np.flatnonzero(reader.present())
        for k in (int(index) for index in present):
            assert np.array_equal(reader.frame(k), pixels_of(k, COUNT, start.format)), f"frame {k}"
            assert reader.field("position_steps")[k] == 3 * k
            assert reader.field("trigger_id")[k] == k + 100
            assert reader.field("camera_frame_id")[k] == k + 200
            assert reader.field("exposure_start_ns")[k] == 1_000_000 * (k + 1)
    return len(present)


@pytest.mark.parametrize("seed", range(40))
def test_after_a_power_cut_the_durable_frames_are_exact_and_the_scan_can_go_on(
    tmp_path: Path, on_lossy_disk: Callable[[Path], LossyDisk], monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    source, start = random.Random(seed), start_of(tmp_path / "a", COUNT)
    scan = create_scan(Path(start.path), start)
    disk = on_lossy_disk(scan.path)
    written = source.randrange(3, COUNT)
    for frame_index in range(written):
        put(scan, start, frame_index)
        if source.random() < 0.15:
            scan.sync()
    durable = scan.durable_count
    cut = disk.after_a_power_cut(source)
    scan.close()
    monkeypatch.undo()
    after = start_of(tmp_path / "b", COUNT)
    Path(after.path).mkdir()
    (tmp_path / "b" / "scan.partial.h5").write_bytes(cut)
    (found,) = recover(tmp_path / "b")
    if found.state == "sealed":
        assert (found.outcome, found.committed, durable) == ("aborted", 0, 0), "closed although something was in it"
        return
    assert found.state == "interrupted"
    assert assert_exact(tmp_path / "b", after) == found.committed >= durable
    again = ScanFile.open_existing(tmp_path / "b")
    for frame_index in range(COUNT):
        put(again, after, frame_index)
    assert again.seal(Outcome.COMPLETE).committed == COUNT
    again.close()
    assert verify(tmp_path / "b").complete and assert_exact(tmp_path / "b", after) == COUNT


@pytest.mark.parametrize("seed", range(10))
def test_a_power_cut_while_sealing_leaves_a_scan_that_recover_closes_or_names(
    tmp_path: Path, on_lossy_disk: Callable[[Path], LossyDisk], monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    source, start = random.Random(seed), start_of(tmp_path / "a", COUNT)
    scan = create_scan(Path(start.path), start)
    disk = on_lossy_disk(scan.path)
    for frame_index in range(COUNT):
        put(scan, start, frame_index)
    scan._put_digest()
    scan._put_outcome(Outcome.COMPLETE, "")
    if source.random() < 0.5:
        scan.sync()
    cut = disk.after_a_power_cut(source)
    scan.close()
    monkeypatch.undo()
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "scan.partial.h5").write_bytes(cut)
    (found,) = recover(tmp_path / "b")
    there = assert_exact(tmp_path / "b", start)
    assert found.committed == there
    assert found.outcome == ("complete" if found.state == "sealed" else "interrupted")
    assert found.state == "interrupted" or there == COUNT
