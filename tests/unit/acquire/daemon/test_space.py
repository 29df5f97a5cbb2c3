"""Space is asked for before anything moves, in words that say how much, where, for how long, and the way out."""

from __future__ import annotations

from collections import namedtuple

import pytest

from acquire.contract.config.load import load_config
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.daemon import scan_setup as preparing

Usage = namedtuple("Usage", "total used free")
FORMAT = FrameFormat(width=1024, height=768, bit_depth=8, pixel_format="rgb")
PLAN = SweepPlan(0, 1578, 3, 3.175)


def check(tmp_path, monkeypatch, free: int) -> None:
    monkeypatch.setattr(preparing.shutil, "disk_usage", lambda _place: Usage(2**40, 0, free))
    config = load_config(environ={"SWEEPSCOPE_STORAGE__DATA_DIR": str(tmp_path / "not" / "yet")})
    preparing._check_space(config, PLAN, FORMAT)


def test_a_scan_that_does_not_fit_is_refused_with_needed_free_place_duration_and_way_out(tmp_path, monkeypatch):
    with pytest.raises(CommandRefusedError) as refused:
        check(tmp_path, monkeypatch, 1_000_000_000)
    text = str(refused.value)
    for words in ("1.3 GB", "1.0 GB free", str(tmp_path), "527 frames", "0:00:36", "storage.data_dir", "make room"):
        assert words in text, f"{words!r} is missing in {text!r}"


def test_a_scan_that_fits_is_not(tmp_path, monkeypatch):
    check(tmp_path, monkeypatch, 2_000_000_000)
