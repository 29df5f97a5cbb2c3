"""Every file of text that people edit may begin with a byte order mark, as editors on Windows write it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from acquire.contract.calibration import load_calibration
from acquire.contract.config.load import load_config
from acquire.contract.errors import SweepscopeError
from acquire.contract.scan_data.notes import notes_of
from acquire.contract.scan_data.reader import read_marks
from acquire.contract.scan_data.report_file import read_report
from acquire.remote.keys import load_allowed
from process.calibration.quarter_circle.clicks import read_clicks
from tests.fakes.scans.small_scans import CALIBRATION
from tui.console.keys import load_keymap
from tui.scans.copies import copies_of
from tui.scans.json_file import read_object

CLICK = {"point": "corner", "frame": 1, "x": 2.0, "y": 3.0}
KEY = "a" * 40

Reader = Callable[[Path], Any]
FILES: dict[str, tuple[str, Reader]] = {
    "rig.toml": ("[camera]\ngain = 3.5\n", lambda path: load_config(str(path), environ={}).rig),
    "calibration.json": (json.dumps(CALIBRATION), lambda path: load_calibration(path)[0]),
    "notes.json": (json.dumps({"specimen": "stapes"}), lambda path: notes_of(path.parent, {})),
    "marks.json": (json.dumps({"drift_px": 0.5}), lambda path: read_marks(path.parent)),
    "report.json": ('{"counts": {"frames": 3}}', read_report),
    "copies.json": ("[]", lambda path: copies_of(path.parent)),
    "any.json": ('{"a": 1}', read_object),
    "keys.toml": ('"scan.start" = "S"\n', lambda path: load_keymap(path, lambda: {"scan.start"})),
    "allowed.toml": (f'[anna]\nkey = "{KEY}"\nmay = "watch"\n', lambda path: load_allowed(path.parent)),
    "clicks.json": (json.dumps([CLICK]), read_clicks),
    "clicks.csv": ("point,frame,x,y\ncorner,1,2,3\n", read_clicks),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("line_end", ["\n", "\r\n"], ids=["LF", "CRLF"])
def test_a_byte_order_mark_and_other_line_ends_change_nothing(tmp_path, name, line_end):
    text, reader = FILES[name]
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    plain = reader(path)
    path.write_bytes(text.replace("\n", line_end).encode("utf-8-sig"))
    assert reader(path) == plain
    assert plain != read_object(tmp_path / "missing") or name == "copies.json"


@pytest.mark.parametrize("name", [name for name in FILES if name not in ("marks.json", "any.json")])
@pytest.mark.parametrize("bent", ["utf-16", "nul", "latin-1"])
def test_what_is_no_utf8_is_one_sentence(tmp_path, name, bent):
    text, reader = FILES[name]
    path = tmp_path / name
    path.write_bytes(
        {"utf-16": text.encode("utf-16"), "nul": text.encode() + b"\0", "latin-1": b"\xfc" + text.encode()}[bent]
    )
    with pytest.raises(SweepscopeError) as caught:
        reader(path)
    assert "\n" not in str(caught.value) and name in str(caught.value)
