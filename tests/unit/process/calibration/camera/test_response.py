"""How a camera answers to light: gamma is found, its effect said in words, and a linear camera passes."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from acquire.contract.config.model import RigConfig
from acquire.contract.errors import CalibrationError, SweepscopeError
from acquire.rig_tools.exposure_series import take_exposures
from process.calibration.camera.response import find_response
from tui.cli import cli, run

EXPOSURES_MS = (2.0, 4.0, 8.0, 12.0, 16.0, 20.0, 24.0)


def series(gamma: float, black: float = 5.0, noise: float = 1.0, peak: float = 230.0) -> list[np.ndarray]:
    """A scene of many brightnesses at each exposure; counts = black + peak light^gamma."""
    generator = np.random.default_rng(4)
    scene = np.tile(np.linspace(0.05, 1.0, 160), (60, 1))
    found = []
    for exposure_ms in EXPOSURES_MS:
        counts = black + peak * (scene * exposure_ms / EXPOSURES_MS[-1]) ** gamma
        found.append(np.clip(counts + generator.normal(0, noise, scene.shape), 0, 255).round().astype(np.uint8))
    return found


@pytest.mark.parametrize("gamma", [1.0, 0.45, 0.8, 1.3])
def test_gamma_and_black_level_are_found(gamma):
    found = find_response(EXPOSURES_MS, series(gamma), 8)
    assert found.gamma == pytest.approx(gamma, abs=0.02)
    assert found.black_counts == pytest.approx(5.0, abs=2.0)
    assert found.linear == (gamma == 1.0)


def test_saturated_parts_do_not_look_like_a_gamma():
    assert find_response(EXPOSURES_MS, series(1.0, peak=420.0), 8).linear


def test_half_of_the_counts_of_a_camera_with_gamma_comes_early_or_late_and_more_so_without_stray_light():
    found = find_response(EXPOSURES_MS, series(0.45), 8)
    # half of the counts is 0.5^(1 / 0.45) = 0.21 of the light: 0.79 widths before the half
    assert found.shift_widths() == pytest.approx(-0.79, abs=0.04)
    assert found.shift_widths() < found.shift_widths(0.4) < 0
    words = " ".join(found.lines(38.1))
    assert "NOT linear: half of the counts comes -0.7" in words
    assert "switch gamma" in words


def test_the_command_reads_exposures_from_names_and_fails_for_a_camera_that_is_not_linear(tmp_path):
    for exposure_ms, picture in zip(EXPOSURES_MS, series(0.7), strict=True):
        cv2.imwrite(str(tmp_path / f"white-{exposure_ms:g}ms.png"), picture)
    result = CliRunner().invoke(cli, ["calibrate", "response", str(tmp_path), "--json"], standalone_mode=False)
    assert result.return_value == 1
    assert json.loads(result.stdout)["response"]["gamma"] == pytest.approx(0.7, abs=0.02)


def test_a_picture_without_an_exposure_is_named(tmp_path, capsys):
    cv2.imwrite(str(tmp_path / "white.png"), series(1.0)[0])
    assert run(["calibrate", "response", str(tmp_path)]) == 1
    assert "white.png has no exposure in its name" in capsys.readouterr().err


def test_the_simulated_rigs_camera_is_linear(tmp_path, monkeypatch):
    rig = "[camera]\nwidth = 128\nheight = 96\n[simulation]\nobject = 'checkerboard'\ntime_scale = 0.01\n"
    (tmp_path / "rig.toml").write_text(rig)
    arguments = ["--config", str(tmp_path / "rig.toml"), "calibrate", "response", "--rig", "--json"]
    result = CliRunner().invoke(cli, arguments, standalone_mode=False)
    assert result.return_value == 0, result.output
    assert json.loads(result.stdout)["response"]["gamma"] == pytest.approx(1.0, abs=0.03)


def test_a_camera_that_gives_no_picture_is_said_so_and_closed():
    class Dumb:
        closed = False

        def open(self, sink):
            pass

        def configure(self, settings):
            return settings

        def snap(self):
            pass

        def close(self):
            self.closed = True

    camera, config = Dumb(), RigConfig()
    config = type(config)(camera=type(config.camera)(frame_timeout_ms=10.0))
    with pytest.raises(SweepscopeError, match=r"no picture came within .* \(stop the daemon first\)"):
        take_exposures(camera, config, [1.0])
    assert camera.closed


def test_three_exposures_are_too_few():
    with pytest.raises(CalibrationError, match="it takes 4 exposures or more .* 3 were given"):
        find_response(EXPOSURES_MS[:3], series(1.0)[:3], 8)
