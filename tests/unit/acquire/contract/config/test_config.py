"""The configuration: layers, origins, manuals and refusals."""

from __future__ import annotations

import tomllib

import msgspec
import pytest

from acquire.contract.config.allowed import allowed_words
from acquire.contract.config.load import find_config_file, key_docs, load_config
from acquire.contract.config.model import RigConfig
from acquire.contract.errors import ConfigError
from tests import ROOT


def write(path, text):
    path.write_text(text, encoding="utf-8")
    return str(path)


def test_layers_go_default_file_environment_flag(tmp_path):
    flag = write(tmp_path / "rig.toml", "[camera]\nwidth = 640\nheight = 480\ngain = 3.0\n")
    environ = {"SWEEPSCOPE_CAMERA__HEIGHT": "240", "SWEEPSCOPE_CAMERA__GAIN": "4.5"}
    loaded = load_config(flag, {"camera.gain": 9.0}, environ)
    camera = loaded.rig.camera
    assert (camera.width, camera.height, camera.gain) == (640, 240, 9.0)
    origins = [loaded.origins[f"camera.{key}"] for key in ("exposure_ms", "width", "height", "gain")]
    assert origins == ["default", flag, "SWEEPSCOPE_CAMERA__HEIGHT", "flag"]


def test_an_unknown_key_is_refused_with_the_nearest_valid_name(tmp_path):
    flag = write(tmp_path / "rig.toml", "[stage]\ntravel_max_step = 9\n")
    with pytest.raises(ConfigError, match=r"travel_max_step.*did you mean stage\.travel_max_steps"):
        load_config(flag, environ={})


def test_an_unknown_section_is_refused_with_the_nearest_valid_name(tmp_path):
    flag = write(tmp_path / "rig.toml", "[stag]\nport = ''\n")
    with pytest.raises(ConfigError, match=r"\[stag\].*stage"):
        load_config(flag, environ={})


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[camera]\nwidth = 'wide'\n", "camera.width.*int"),
        ("[camera]\nwidth = 3\n", "camera.width"),
        ("[stage]\ntravel_max_steps = -5\n", "travel_max_steps"),
        ("[reconstruct]\nmedian = 4\n", "odd"),
        ("[camera\n", "not valid TOML"),
        ("camera = 3\n", "section"),
        ('[storage]\ndata_dir = "a\\u0000b"\n', "storage.data_dir"),
        (f'[storage]\ndata_dir = "{"a/" * 2000}"\n', "storage.data_dir"),
    ],
)
def test_a_value_that_cannot_be_used_is_named(tmp_path, text, words):
    flag = write(tmp_path / "rig.toml", text)
    with pytest.raises(ConfigError, match=words):
        load_config(flag, environ={})


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("STAGE__KIND", "arduino", "'arduino'; it must be one of legacy, simulated, uno"),
        ("CAMERA__KIND", "webcam", "one of genicam, replay, simulated, uvc"),
        ("SWEEP__MODE", "fast", "one of fly, step"),
        ("RECONSTRUCT__METHOD", "best", "one of auto, fit, linear, probit"),
        ("CAMERA__GAIN", "nan", "a number from 0 to 48"),
        ("CAMERA__GAIN", "-inf", "a number from 0 to 48"),
        ("CAMERA__EXPOSURE_MS", "1e300", "a number above 0, at most 60 000"),
        ("CAMERA__WIDTH", "9" * 400, "a whole number from 16 to 16 384"),
        ("CAMERA__WIDTH", "9" * 5000, "a whole number from 16 to 16 384"),
        ("CAMERA__WIDTH", "640.0", "a whole number"),
        ("CAMERA__WIDTH", "true", "a whole number"),
        ("SIMULATION__DISTORTION", "[0, 0, nan, 0, 0]", "a list of 5, each a number from -100 to 100"),
        ("SIMULATION__DISTORTION", "[0, 0]", "a list of 5"),
        ("SWEEP__REPEAT_FIRST", "maybe", "true or false"),
        ("CAMERA__GAIN", "[" * 10_000, "a number"),
        ("CAMERA__KINDS", "uvc", r"unknown key camera\.kinds; did you mean camera\.kind\?"),
    ],
)
def test_a_refused_value_comes_with_what_is_allowed(name, value, words):
    with pytest.raises(ConfigError, match=words):
        load_config(environ={f"SWEEPSCOPE_{name}": value})


@pytest.mark.parametrize(("value", "width"), [("0x400", 1024), ("1_024", 1024), ("0b100000", 32)])
def test_numbers_may_be_written_as_toml_has_them(value, width):
    assert load_config(environ={"SWEEPSCOPE_CAMERA__WIDTH": value}).rig.camera.width == width


def test_a_variable_that_lacks_an_underscore_is_refused_with_the_right_name():
    with pytest.raises(ConfigError, match="SWEEPSCOPE_STAGE_KIND sets nothing: did you mean SWEEPSCOPE_STAGE__KIND"):
        load_config(environ={"SWEEPSCOPE_STAGE_KIND": "uno"})


def test_every_number_has_bounds_and_every_key_its_words():
    """A float without bounds takes NaN and infinity."""
    found = allowed_words()
    assert set(found) == set(load_config(environ={}).origins)
    assert [key for key, words in found.items() if words in ("a number", "a whole number")] == []


def test_the_manual_in_the_docs_is_that_of_the_command():
    defaults = load_config(environ={"XDG_CONFIG_HOME": "/nonexistent"})
    assert defaults.explained().replace("  # default", "") in (ROOT / "docs/configuration.md").read_text()


def test_without_a_home_the_system_configuration_counts(monkeypatch):
    monkeypatch.delenv("HOME", raising=False)
    monkeypatch.setattr("os.path.expanduser", lambda path: path)
    assert find_config_file(None, {}) is None
    with pytest.raises(ConfigError, match="set HOME"):
        _ = load_config(environ={}).data_dir


def test_a_configuration_that_is_named_and_missing_is_an_error():
    with pytest.raises(ConfigError, match="nowhere.toml"):
        load_config("/nowhere.toml", environ={})
    with pytest.raises(ConfigError, match="SWEEPSCOPE_CONFIG"):
        find_config_file(None, {"SWEEPSCOPE_CONFIG": "/nowhere.toml"})


def test_every_key_has_a_manual():
    rig = RigConfig()
    for section in msgspec.to_builtins(rig):
        struct = type(getattr(rig, section))
        missing = set(struct.__struct_fields__) - set(key_docs(struct))
        assert not missing, f"[{section}] has no manual for {missing}"


def test_the_explained_configuration_is_valid_toml_and_reads_back(tmp_path):
    loaded = load_config(overrides={"camera.gain": 7.5}, environ={})
    again = load_config(write(tmp_path / "rig.toml", loaded.explained()), environ={})
    assert again.rig == loaded.rig
    assert tomllib.loads(loaded.toml())["camera"]["gain"] == 7.5
