"""The service files as systemd sees them: understood, locked down, and patient enough for what the services do."""

from __future__ import annotations

import configparser
import re
import shutil
from pathlib import Path

import pytest

from acquire.contract.config.model import LimitsConfig
from tests import ROOT
from tests.needs import need
from tests.waiting import run

UNITS = ROOT / "systemd" / "system"
COMMON = "sweepscope-.service.d/10-common.conf"
"""Settings of all services; systemd adds them to each."""
SERVICES = sorted(path.name for path in UNITS.glob("*.service"))
WORST = 2.0
NETWORKED = ("sweepscope-viewer.service", "sweepscope-gateway.service")


@pytest.fixture(scope="module")
def analyze() -> str:
    need("systemd")
    return str(shutil.which("systemd-analyze"))


@pytest.fixture
def units(tmp_path: Path) -> Path:
    """The units with a program in them that is there."""
    shutil.copytree(UNITS, tmp_path, dirs_exist_ok=True)
    for path in tmp_path.glob("*.service"):
        path.write_text(path.read_text().replace("/opt/sweepscope/current/bin/sweepscope", "/bin/true"))
    return tmp_path


def complaints(analyze: str, *paths: Path) -> str:
    # an unknown key does not change the exit status: only what is said counts
    done = run([analyze, "verify", "--man=no", *paths])
    return "\n".join(line for line in done.stderr.splitlines() if "sweepscope" in line)


def test_systemd_has_nothing_to_say_about_the_units(analyze: str, units: Path) -> None:
    assert complaints(analyze, *(path for path in units.iterdir() if path.is_file())) == ""


@pytest.mark.parametrize(
    ("file", "key"), [("sweepscope-daemon.service", "WatchdogSec"), (COMMON, "ProtectHome")], ids=["unit", "drop-in"]
)
def test_a_misspelt_key_would_be_noticed(analyze: str, units: Path, file: str, key: str) -> None:
    path = units / file
    path.write_text(path.read_text().replace(f"{key}=", f"{key}x="))
    assert f"{key}x" in complaints(analyze, units / "sweepscope-daemon.service")


@pytest.mark.parametrize("service", SERVICES)
def test_no_service_is_more_exposed_than_two_of_ten(analyze: str, service: str) -> None:
    command = [analyze, "security", "--offline=true", "--no-pager", str(UNITS / service)]
    done = run(command)
    score = re.search(r"exposure level for \S+: ([0-9.]+)", done.stdout + done.stderr)
    assert score, done.stdout + done.stderr
    assert float(score[1]) <= WORST


def seconds(unit: str, key: str) -> float:
    text = re.search(rf"^{key}=(\d+)s$", (UNITS / unit).read_text(), re.MULTILINE)
    assert text
    return float(text[1])


def test_systemd_waits_longer_than_the_services_clean_up() -> None:
    limits = LimitsConfig()
    assert seconds("sweepscope-daemon.service", "TimeoutStopSec") > limits.stop_s
    assert seconds("sweepscope-writer.service", "TimeoutStopSec") > limits.seal_s


def test_only_viewer_and_gateway_have_a_network_and_only_the_daemon_has_devices() -> None:
    for service in SERVICES:
        text = (UNITS / service).read_text()
        assert ("PrivateNetwork=yes" in text) == (service not in NETWORKED)
        assert ("PrivateDevices=yes" in text) == (service != "sweepscope-daemon.service")


def test_no_service_is_needed_by_another_so_that_any_may_die() -> None:
    for path in (path for path in UNITS.rglob("*") if path.is_file()):
        parser = configparser.RawConfigParser(strict=False, interpolation=None)
        parser.read(path)
        assert not set(parser["Unit"]) & {"requires", "bindsto", "requisite"}
