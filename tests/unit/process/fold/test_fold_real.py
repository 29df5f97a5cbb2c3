"""The fold on a real public scan: a stick's shadow over a frog."""

from __future__ import annotations

import cv2
import numpy as np

from process.fold.fold import Fold, to_grey


def test_the_real_scan_gives_the_known_counts_and_sum_of_crossings(real_scan):
    paths = sorted((real_scan / "frames").glob("*.jpg"))
    read = [cv2.imread(str(path)) for path in paths]
    frames = [cv2.cvtColor(frame, cv2.COLOR_BGR2RGB) for frame in read]
    fold = Fold(frames[0].shape[:2], bit_depth=8, edge="falling", frames_expected=len(frames))
    for index, frame in enumerate(frames):
        fold.add(index, frame)
    maps = fold.result(contrast=50, median=0, noise_counts=2.0, read_columns=None)
    for bgr, rgb in zip(read[:3], frames, strict=False):
        np.testing.assert_array_equal(to_grey(rgb, 8), cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY))
    counts = {name: maps.counts[name] for name in ("over_contrast", "past_s_in_first", "crossings", "unresolved")}
    assert counts == {"over_contrast": 172192, "past_s_in_first": 8, "crossings": 172184, "unresolved": 0}
    assert round(float(np.nansum(maps.crossing)), 2) == 15_773_369.54
