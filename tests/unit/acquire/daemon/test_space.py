"""Space is asked for before anything moves, in words that say how much, where, for how long, and the way out."""

from __future__ import annotations

import shutil
from collections import namedtuple

import pytest

from acquire.contract.config.load import load_config
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import FrameFormat
from acquire.daemon.requests import ScanRequest
from acquire.daemon.scan_setup import CheckedScan, check_scan
from tests.unit.rig_in_process import known_rig

Usage = namedtuple("Usage", "total used free")
FORMAT = FrameFormat(width=1024, height=768, bit_depth=8, pixel_format="rgb")
NEEDED = (527 + 4) * FORMAT.nbytes
"""The frames of the default plan, and one for each of the checks."""


def check(tmp_path, monkeypatch, free: int) -> CheckedScan:
    monkeypatch.setattr(shutil, "disk_usage", lambda _place: Usage(2**40, 0, free))
    config = load_config(environ={"SWEEPSCOPE_STORAGE__DATA_DIR": str(tmp_path / "not" / "yet")})
    raw = ScanRequest(purpose="raw")
    return check_scan(raw, config, known_rig(FORMAT, exposure_ms=30))


def test_a_scan_that_does_not_fit_is_refused_with_needed_free_place_duration_and_way_out(tmp_path, monkeypatch):
    with pytest.raises(CommandRefusedError) as refused:
        check(tmp_path, monkeypatch, 1_000_000_000)
    text = str(refused.value)
    for words in ("1.3 GB", "1.0 GB free", str(tmp_path), "527 frames", "0:00:36", "storage.data_dir", "make room"):
        assert words in text, f"{words!r} is missing in {text!r}"


def test_a_scan_that_just_fits_is_allowed_and_one_byte_less_is_not(tmp_path, monkeypatch):
    found = check(tmp_path, monkeypatch, NEEDED)
    assert (found.needed_bytes, found.free_bytes) == (NEEDED, NEEDED)
    with pytest.raises(CommandRefusedError, match="make room"):
        check(tmp_path, monkeypatch, NEEDED - 1)
