"""Homing makes a new zero: scans record which one, a calibration of another one is warned of, rezero corrects it."""

from __future__ import annotations

import json
from pathlib import Path

from click.testing import CliRunner

from acquire.contract.scan_data.file_layout import read_layout
from acquire.writer.verify import info
from tests.system.appliance import Appliance
from tui.cli import cli

BOARD = {
    "CAMERA__WIDTH": 256,
    "CAMERA__HEIGHT": 192,
    "SIMULATION__OBJECT": "checkerboard",
    "SIMULATION__COLOUR": "false",
    "SIMULATION__BOARD_COLUMNS": 12,
    "SIMULATION__BOARD_ROWS": 9,
    "SIMULATION__BOARD_SQUARE_MM": 0.5,
    "SWEEP__STEPS_PER_FRAME": 8,
}
WARNING = "the stage was homed since the calibration"


def swept(appliance, client) -> str:
    """A sweep over the board; its folder."""
    found = appliance.scan(client, purpose="calibration")
    return appliance.finished(client, found["scan_uid"]).scan_path


def run(*arguments: str) -> str:
    result = CliRunner().invoke(cli, list(arguments), standalone_mode=False)
    assert result.exception is None, result.exception
    return result.output


def test_a_calibration_of_before_homing_is_warned_of_until_it_is_rezeroed(run_dir, tmp_path):
    appliance = Appliance(run_dir, tmp_path / "scans", **BOARD)
    try:
        appliance.start("daemon", "writer")
        with appliance.client() as client:
            before = swept(appliance, client)
            first = client.status().zero_id
            client.request("home")
            appliance.until_status(
                client, lambda s: s.state == "idle" and s.zero_id not in ("", first), "the stage is homed"
            )
            after = swept(appliance, client)
    finally:
        appliance.close()
    zeros = [info(Path(scan)).zero_id for scan in (before, after)]
    assert zeros[0] == first
    assert zeros[1] not in ("", first)
    document = json.loads(read_layout(Path(after)).verbatim["calibration"])
    document["valid_for"] |= {"zero_id": first, "created_utc": "2026-01-01T00:00:00Z", "days": 30}
    (tmp_path / "old.json").write_text(json.dumps(document))
    old, new, out = str(tmp_path / "old.json"), str(tmp_path / "new.json"), ["--out", str(tmp_path / "points")]
    assert WARNING in run("reconstruct", after, "--calibration", old, *out)
    assert WARNING not in run("reconstruct", before, "--calibration", old, *out)
    run("calibrate", "rezero", after, "--calibration", old, "--squares", "12x9", "--square-mm", "0.5", "--out", new)
    assert json.loads((tmp_path / "new.json").read_text())["valid_for"]["zero_id"] == zeros[1]
    assert WARNING not in run("reconstruct", after, "--calibration", new, *out)
