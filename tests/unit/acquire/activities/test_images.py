"""Pictures for people: small, and with the brightness of what they were made of."""

from __future__ import annotations

import numpy as np
import pytest

from acquire.activities.images import measure, reduce
from acquire.contract.messaging.messages import FrameFormat


def form(height, width, bit_depth=8, pixel_format="mono"):
    return FrameFormat(width=width, height=height, bit_depth=bit_depth, pixel_format=pixel_format)


def test_a_frame_is_averaged_by_area_and_never_widened():
    frame = np.zeros((768, 1024), np.uint8)
    frame[::2] = 200
    small = reduce(frame, form(768, 1024))
    assert small.shape == (384, 512) and (small == 100).all()
    assert reduce(frame[:48, :64], form(48, 64)).shape == (48, 64)


@pytest.mark.parametrize("bit_depth", [10, 12, 16])
def test_deep_frames_become_8_bit(bit_depth):
    frame = np.full((48, 64), (1 << bit_depth) - 1, np.uint16)
    assert (reduce(frame, form(48, 64, bit_depth)) == 255).all()
    found = measure(frame, bit_depth)
    assert found.high == found.low == 255 and found.full_scale_share == 1


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "grbg", "gbrg"])
def test_a_bayer_frame_becomes_a_colour_picture(pattern):
    frame = np.empty((48, 64), np.uint8)
    for cell, colour in enumerate(pattern):
        frame[cell // 2 :: 2, cell % 2 :: 2] = {"r": 200, "g": 100, "b": 50}[colour]
    small = reduce(frame, form(48, 64, 8, f"bayer_{pattern}"))
    assert small.shape == (24, 32, 3) and (small == (200, 100, 50)).all()


def test_brightness_is_that_of_the_brightest_channel_in_8_bit_counts():
    frame = np.zeros((100, 100, 3), np.uint8)
    frame[..., 2] = np.arange(100)[None] * 2
    frame[:, 99, 0] = 255
    found = measure(frame, 8)
    assert found.full_scale_share == pytest.approx(0.01)
    assert found.low == pytest.approx(0, abs=2) and found.high == 255


def test_very_large_frames_are_thinned_first():
    frame = np.full((3000, 4500, 3), 77, np.uint8)
    small = reduce(frame, form(3000, 4500, 8, "rgb"))
    assert small.shape == (300, 450, 3) and (small == 77).all()
