"""Reprocessing and calibrating from the console in a real terminal, with the real child processes behind it."""

from __future__ import annotations

import json

import numpy as np

from acquire.activities.capture import write_png
from acquire.contract.calibration import load_calibration
from acquire.contract.config.simulation import SimulationConfig
from acquire.simulation import Renderer, build_scene
from acquire.simulation.calibration import ideal_calibration
from tests.fakes.scans.small_scans import make_scan
from tests.system.appliance import Appliance
from tests.system.console.test_cli_tmux import CONSOLE, Terminal, terminal
from tests.unit.rig_in_process import RigInProcess
from tui.console.calibration.session import BoardPattern, CalibrationSession

__all__ = ["terminal"]


def at(terminal: Terminal, data_dir) -> Terminal:
    terminal.environ["SWEEPSCOPE_STORAGE__DATA_DIR"] = str(data_dir)
    return terminal


def test_a_scan_is_reprocessed_and_its_maps_are_looked_at(terminal, tmp_path):
    folder = make_scan(tmp_path / "ear", 40, count=40)
    at(terminal, tmp_path).open(*CONSOLE)
    terminal.press("4")
    terminal.wait_for("SAVED", "ear")
    terminal.press("m")
    terminal.wait_for("maps, no cloud")
    assert (folder / "maps.h5").is_file()
    terminal.wait_for("o open")
    terminal.press("o")
    terminal.wait_for("ear (maps.h5)", "crossing time", "pixels over it")
    terminal.press("}")
    terminal.wait_for("contrast  80")
    terminal.press("q")
    terminal.wait_for("STATUS=0")


def tilted_view(tilt_y_deg: float) -> np.ndarray:
    config = SimulationConfig(object="checkerboard", colour=False, tilt_y_deg=tilt_y_deg)
    scene = build_scene(config, width=256, height=192, um_per_microstep=3.175)
    return Renderer(scene).render(4000, exposure_ms=30.0, gain=6.0, brightness=0.0)


def test_a_camera_is_calibrated_with_a_view_that_is_captured_from_the_terminal(terminal, run_dir, tmp_path):
    session = CalibrationSession(tmp_path)
    session.save_board(BoardPattern())
    for tilt_y_deg in (-12.0, 12.0):  # two are there from before: a session can be resumed
        write_png(session.next_view(), tilted_view(tilt_y_deg), "mono")
    settings = {"camera.width": 256, "camera.height": 192, "simulation.colour": False}
    with RigInProcess(run_dir, tmp_path, settings) as rig:
        rig.ask("lamp", on=True)
        rig.ask("preview", on=True, rate_hz=10)
        at(terminal, tmp_path).open(*CONSOLE, width=160, height=50)
        terminal.wait_for("PREVIEW")
        terminal.press("3")
        terminal.wait_for("left side higher")
        terminal.press("P")
        terminal.wait_for("): a new view")
        terminal.press("c")
        terminal.wait_for("view-03 flat")
        terminal.press("g")
        terminal.wait_for("px RMS, 3 of 3 views used")
        terminal.press("q")
        terminal.wait_for("STATUS=0")
    assert json.loads(session.result.read_text())["camera"]["width"] == 256


BOARD = {"CAMERA__WIDTH": 384, "CAMERA__HEIGHT": 288, "SIMULATION__COLOUR": "false", "SWEEP__STEPS_PER_FRAME": 9,
         "SIMULATION__BOARD_COLUMNS": 20, "SIMULATION__BOARD_ROWS": 15, "SWEEP__MAX_RATE_HZ": 15}  # fmt: skip
"""The board fills the field: so its poses are told from small pictures as well."""


def with_known_camera(data_dir) -> dict:
    """A session whose first step is done; returns the exact calibration."""
    scene = build_scene(SimulationConfig(), width=384, height=288, um_per_microstep=3.175)
    exact = ideal_calibration(scene, first_steps=0, steps_per_frame=9, count=176)
    session = CalibrationSession(data_dir)
    session.save_board(BoardPattern(columns=20, rows=15))
    session.result.write_text(json.dumps({name: exact[name] for name in ("format", "version", "camera")}))
    return exact


def test_the_light_plane_is_calibrated_from_the_terminal_with_sweeps_over_the_board_flat_and_tilted(
    terminal, run_dir, tmp_path
):
    exact = with_known_camera(tmp_path)
    rig = Appliance(run_dir, tmp_path, **BOARD)
    terminal.environ |= {name: value for name, value in rig.environ.items() if name.startswith("SWEEPSCOPE_")}
    try:
        rig.start("daemon", "writer")
        rig.client().close()
        terminal.open(*CONSOLE, width=160, height=50)
        terminal.wait_for("IDLE")
        terminal.press("3", "m")
        for number in (1, 2):
            terminal.press("P")
            terminal.wait_for(f"tilted by {0 if number == 1 else 12} and 0 degrees")
            terminal.press("e")
            terminal.wait_for("of full scale; locked")
            terminal.press("w")
            terminal.wait_for(f"board-{number}  SAVED")
            terminal.wait_for("● IDLE")  # the outcome is shown before the rig is idle
        terminal.press("g")
        terminal.wait_for("PASSED: 2 surfaces")
        terminal.press("q")
        terminal.wait_for("STATUS=0")
    finally:
        rig.close()
    found, _ = load_calibration(CalibrationSession(tmp_path).result)
    cosine = np.dot(found.light_plane.normal, exact["light_plane"]["normal"])
    assert np.degrees(np.arccos(cosine)) < 0.5
