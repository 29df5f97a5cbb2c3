"""The order of the fold: whatever comes whenever, each frame is folded once and in its turn."""

from __future__ import annotations

import numpy as np
import pytest

from process.results.fold_cursor import FoldCursor


class RecordingFold:
    """Remembers what it was fed; refuses frames marked as poison."""

    def __init__(self) -> None:
        self.fed: list[tuple[int, int]] = []

    def add(self, frame_index: int, frame: np.ndarray, *, keep: bool) -> None:
        if frame[0] == 66:
            raise ValueError("poison")
        assert not self.fed or frame_index > self.fed[-1][0]
        self.fed.append((frame_index, int(frame[0])))

    def room(self) -> np.ndarray:
        return np.empty(1)


class MemoryFile:
    """A scan file of one-pixel frames; frame k holds k + 1 and has the checksum 100 + k."""

    def __init__(self, count: int) -> None:
        self.damaged: set[int] = set()
        self.torn: set[int] = set()
        self._present = np.zeros(count, bool)
        self._crc32 = np.zeros(count, np.uint32)

    def commit(self, *frames: int) -> MemoryFile:
        for k in frames:
            self._present[k], self._crc32[k] = True, 100 + k
        return self

    def present(self) -> np.ndarray:
        return self._present.copy()

    def field(self, name: str) -> np.ndarray:
        return {"crc32": self._crc32}[name].copy()

    def pixels(self, frame_index: int, crc32: int, room: np.ndarray | None = None) -> np.ndarray | None:
        assert crc32 == 100 + frame_index
        if frame_index in self.torn:
            self.damaged.add(frame_index)
            return None
        return pixels(frame_index)


def pixels(frame_index: int) -> np.ndarray:
    return np.array([frame_index + 1])


def cursor_of(count: int, room: int = 4) -> FoldCursor:
    return FoldCursor(RecordingFold, count, room)


def offer(cursor: FoldCursor, *frames: int) -> None:
    for k in frames:
        cursor.offer(k, 100 + k, pixels(k))


def fed(cursor: FoldCursor) -> list[int]:
    return [index for index, _ in cursor.fold.fed]


EVER = np.ones(8, bool)


def test_live_frames_in_order_are_folded_at_once():
    cursor = cursor_of(3)
    offer(cursor, 0, 1, 2)
    assert fed(cursor) == [0, 1, 2] and cursor.done
    assert cursor.counts.from_live == 3


def test_early_frames_wait_for_the_gap_and_follow_it():
    cursor = cursor_of(8)
    offer(cursor, 0, 3, 2)
    assert fed(cursor) == [0]
    offer(cursor, 1)
    assert fed(cursor) == [0, 1, 2, 3]


def test_a_gap_is_filled_from_the_file_and_the_waiting_frames_follow():
    cursor = cursor_of(8)
    offer(cursor, 0, 2, 3)
    assert cursor.fill(MemoryFile(8).commit(0, 1), limit=9) == 1
    assert fed(cursor) == [0, 1, 2, 3]
    assert (cursor.counts.from_live, cursor.counts.from_file) == (3, 1)


def test_an_uncommitted_frame_is_waited_for():
    cursor = cursor_of(8)
    offer(cursor, 0)
    assert cursor.fill(MemoryFile(8).commit(0, 2), limit=9) == 0
    assert fed(cursor) == [0]


def test_a_frame_that_never_comes_is_skipped():
    cursor = cursor_of(8)
    cursor.fill(MemoryFile(8).commit(0, 1, 4), limit=9, never=EVER)
    assert fed(cursor) == [0, 1, 4] and cursor.done


def test_reading_stops_at_the_limit_and_at_the_last_frame_asked_for():
    cursor, file = cursor_of(8), MemoryFile(8).commit(*range(8))
    assert cursor.fill(file, limit=2) == 2
    assert cursor.fill(file, limit=9, through=4) == 3
    assert fed(cursor) == [0, 1, 2, 3, 4]


def test_doubled_late_and_impossible_frames_are_ignored():
    cursor = cursor_of(3)
    offer(cursor, 0, 0, 1, 0, 7)
    assert fed(cursor) == [0, 1]


def test_a_full_buffer_drops_counts_and_reads_the_frame_from_the_file():
    cursor = cursor_of(8, room=2)
    offer(cursor, 1, 2, 3)
    assert cursor.counts.buffer_full == 1
    cursor.fill(MemoryFile(8).commit(*range(8)), limit=9)
    assert fed(cursor) == list(range(8))


def test_a_torn_frame_in_the_file_counts_as_missing():
    cursor, file = cursor_of(4), MemoryFile(4).commit(0, 1, 2, 3)
    file.torn.add(2)
    cursor.fill(file, limit=9)
    assert fed(cursor) == [0, 1, 3]
    assert cursor.differs_from(file) == []


def test_the_comparison_names_frames_that_differ_are_absent_or_were_left_out():
    cursor = cursor_of(4)
    offer(cursor, 0)
    cursor.offer(1, 999, pixels(1))
    offer(cursor, 2)
    assert cursor.differs_from(MemoryFile(4).commit(0, 1, 3)) == [1, 2, 3]


def test_after_a_poisonous_frame_everything_is_folded_anew_from_the_file():
    cursor = cursor_of(4)
    offer(cursor, 0)
    with pytest.raises(ValueError, match="poison"):
        cursor.offer(1, 101, np.array([66]))
    cursor.restart()
    cursor.fill(MemoryFile(4).commit(0, 1, 2, 3), limit=9)
    assert fed(cursor) == [0, 1, 2, 3]
    assert cursor.counts.refolded == 1
    assert (cursor.counts.from_live, cursor.counts.from_file) == (0, 4)


@pytest.mark.parametrize("seed", range(30))
def test_any_mix_of_live_and_file_feeds_every_present_frame_once_in_order(seed):
    rng = np.random.default_rng(seed)
    count = 24
    missing = set(rng.choice(count, 3).tolist())
    arrivals = [k for k in range(count) if k not in missing and rng.random() < 0.7]
    arrivals = sorted(arrivals, key=lambda k: k + rng.uniform(0, 5))
    cursor, file = cursor_of(count, room=int(rng.integers(1, 6))), MemoryFile(count)
    for k in range(count):
        if k not in missing:
            file.commit(k)
        while arrivals and rng.random() < 0.8:
            offer(cursor, arrivals.pop(0))
        if rng.random() < 0.3:
            cursor.fill(file, limit=int(rng.integers(1, 4)))
    offer(cursor, *arrivals)
    while not cursor.done:
        cursor.fill(file, limit=3, never=np.ones(count, bool))
    assert fed(cursor) == [k for k in range(count) if k not in missing]
    assert cursor.counts.from_live + cursor.counts.from_file == count - len(missing)
