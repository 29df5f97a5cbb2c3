"""The doctor: each check finds the problem, and each problem comes with a fix."""

from __future__ import annotations

import json
import os
from datetime import UTC, datetime
from pathlib import Path

import msgspec
import pytest

from acquire.contract.config.load import load_config
from acquire.contract.config.model import CameraConfig, StageConfig
from acquire.contract.errors import NoServiceError
from acquire.contract.messaging.messages import FaultReport, Status
from tests.fakes.processes.sweep_source import calibration_json
from tui.install import checks
from tui.install.checks import (
    DoctorFinding,
    Login,
    check_camera,
    check_clock,
    check_firmware,
    check_groups,
    check_python,
    check_space,
    check_speed,
    check_stage,
    needed_bytes_per_s,
)
from tui.install.doctor import KeyFacts, check_calibration, check_network, check_services, check_sockets, examine

NOW = datetime(2026, 6, 1, tzinfo=UTC)
READY = Status(state="idle", stage_kind="uno", camera_kind="uvc", stage_version="1.00", writer_alive=True)
UVC = CameraConfig(kind="uvc")


def dev(tmp_path: Path, *names: str) -> Path:
    """A /dev with these files in it."""
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    return tmp_path


def level(finding: DoctorFinding) -> str:
    assert finding.fix or finding.level != "wrong", f"no fix: {finding}"
    return finding.level


def test_an_old_python_is_wrong_and_ours_is_right() -> None:
    assert (level(check_python((3, 10, 4))), level(check_python())) == ("wrong", "ok")


@pytest.mark.parametrize(
    ("login", "expected"),
    [
        (Login("ann", False, ("ann",), True), "ok"),
        (Login("root", True, (), False), "ok"),
        (Login("ann", False, None, False), "wrong"),
        (Login("ann", False, (), False), "wrong"),
        (Login("ann", False, ("ann",), False), "wrong"),
    ],
)
def test_who_may_use_the_rig_has_the_group_in_this_very_login(login: Login, expected: str) -> None:
    assert level(check_groups(login, installed=True)) == expected
    assert level(check_groups(login, installed=False)) == "ok"


@pytest.mark.parametrize(
    ("present", "port", "expected"),
    [
        ((), "", "wrong"),
        (("ttyACM0",), "", "ok"),
        (("ttyACM0", "ttyUSB0"), "", "wrong"),
        (("ttyACM0", "ttyUSB0", "sweepscope-stage"), "", "ok"),
        (("ttyACM0",), "ttyACM7", "wrong"),
        (("serial/by-id/usb-1", "serial/by-id/usb-2", "sweepscope-stage"), "", "ok"),
    ],
)
def test_the_port_of_the_stage_is_there_and_only_one(
    tmp_path: Path, present: tuple[str, ...], port: str, expected: str
) -> None:
    stage = StageConfig(kind="uno", port=str(tmp_path / port) if port else "")
    assert level(check_stage(stage, dev(tmp_path, *present))) == expected


def test_a_device_that_may_not_be_opened_names_the_group_to_join(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may open everything
    machine = dev(tmp_path, "ttyACM0", "video0")
    for finding in (check_stage(StageConfig(kind="uno"), machine), check_camera(UVC, None, machine)):
        assert level(finding) == "wrong"
        assert f"join the group {machine.group()}" in finding.fix


def test_a_simulated_rig_needs_no_device(tmp_path: Path) -> None:
    assert level(check_stage(StageConfig(), tmp_path)) == level(check_camera(CameraConfig(), None, tmp_path)) == "ok"


def test_the_firmwares_version_is_said_by_the_daemon_that_runs() -> None:
    uno = StageConfig(kind="uno")
    assert check_firmware(uno, READY).text == "version 1.00"
    assert level(check_firmware(uno, None)) == "note"
    assert level(check_firmware(uno, msgspec.structs.replace(READY, stage_version=""))) == "note"


def test_a_camera_is_there_or_open_or_missed(tmp_path: Path) -> None:
    assert level(check_camera(UVC, None, tmp_path)) == "wrong"
    assert level(check_camera(UVC, READY, tmp_path)) == "ok"
    assert level(check_camera(UVC, None, dev(tmp_path, "video0"))) == "ok"


def test_a_daemon_with_another_camera_than_the_configuration_is_wrong(tmp_path: Path) -> None:
    assert level(check_camera(CameraConfig(kind="genicam"), READY, tmp_path)) == "wrong"
    assert level(check_camera(CameraConfig(kind="genicam"), None, tmp_path)) == "note"


@pytest.mark.parametrize(("free", "expected"), [(99, "wrong"), (100, "note"), (1000, "ok")])
def test_a_disk_has_room_for_a_sweep_and_better_for_ten(tmp_path: Path, free: int, expected: str) -> None:
    assert level(check_space(tmp_path, free, 100)) == expected


def test_a_disk_slower_than_the_camera_is_wrong_and_measuring_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(checks, "SPEED_BYTES", 2_000_000)
    assert level(check_speed(tmp_path / "not-yet-there", 1.0)) == "ok"
    assert level(check_speed(tmp_path, 1e15)) == "wrong"
    assert list(tmp_path.iterdir()) == []


def test_sixteen_bits_are_twice_as_many_bytes_per_second() -> None:
    deep = load_config(environ={"SWEEPSCOPE_SIMULATION__BIT_DEPTH": "12"})
    assert needed_bytes_per_s(deep) == 2 * needed_bytes_per_s(load_config(environ={}))


@pytest.mark.parametrize(
    ("year", "by_network", "expected"),
    [(1970, None, "wrong"), (2026, False, "note"), (2026, True, "ok"), (2026, None, "ok")],
)
def test_a_clock_that_is_not_set_is_found(year: int, by_network: bool | None, expected: str) -> None:
    assert level(check_clock(NOW.replace(year=year), by_network)) == expected


def calibration(tmp_path: Path, created: str, days: float | None = None) -> str:
    path = tmp_path / "calibration.json"
    fields = json.loads(calibration_json(64, 48)) | {"valid_for": {"created_utc": created, "days": days}}
    path.write_text(json.dumps(fields))
    return str(path)


def test_a_calibration_is_there_and_of_this_quarter(tmp_path: Path) -> None:
    assert level(check_calibration(calibration(tmp_path, "2026-05-30T00:00:00Z"), "uvc", NOW)) == "ok"
    assert level(check_calibration(calibration(tmp_path, "2025-01-01T00:00:00Z"), "uvc", NOW)) == "note"
    assert level(check_calibration(calibration(tmp_path, "2026-05-30T00:00:00Z", days=1), "uvc", NOW)) == "note"
    assert level(check_calibration(calibration(tmp_path, "yesterday"), "uvc", NOW)) == "wrong"
    assert level(check_calibration(str(tmp_path / "none.json"), "uvc", NOW)) == "wrong"
    assert level(check_calibration("", "uvc", NOW)) == "note"
    assert level(check_calibration("", "simulated", NOW)) == "ok"


def nobody() -> Path:
    raise NoServiceError("no rig daemon answers")


def test_sockets_are_there_and_closed_to_others(tmp_path: Path) -> None:
    tmp_path.chmod(0o750)
    assert level(check_sockets(lambda: tmp_path)) == "ok"
    tmp_path.chmod(0o755)
    assert level(check_sockets(lambda: tmp_path)) == "wrong"
    assert level(check_sockets(nobody)) == "wrong"


def test_services_answer_and_have_no_unacknowledged_fault() -> None:
    fault = FaultReport(code="F03", happened="writer lost", safe="all", to_do="wait")
    assert level(check_services(READY, "")) == "ok"
    assert level(check_services(None, "no rig daemon answers")) == "wrong"
    assert level(check_services(msgspec.structs.replace(READY, writer_alive=False), "")) == "wrong"
    assert level(check_services(msgspec.structs.replace(READY, faults=[fault]), "")) == "note"


KEYS = KeyFacts(Path("/nonexistent"), lambda: 0)


def test_an_offer_to_other_machines_has_a_key_of_its_own_and_lets_somebody_in(tmp_path: Path) -> None:
    key = tmp_path / "server.key"
    assert level(check_network("", "127.0.0.1", KEYS)) == "ok"
    assert level(check_network("", "0.0.0.0", KEYS)) == "note"
    assert level(check_network("10.0.0.1", "127.0.0.1", KeyFacts(key, lambda: 1))) == "wrong"
    key.touch(0o644)
    assert level(check_network("10.0.0.1", "127.0.0.1", KeyFacts(key, lambda: 1))) == "wrong"
    key.chmod(0o600)
    assert level(check_network("10.0.0.1", "127.0.0.1", KeyFacts(key, lambda: 1))) == "ok"
    assert level(check_network("10.0.0.1", "127.0.0.1", KeyFacts(key, lambda: 0))) == "note"


def unreachable() -> Status:
    raise NoServiceError("no rig daemon answers")


def test_an_examination_asks_everything_and_never_raises(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(checks, "SPEED_BYTES", 1_000_000)
    variables = {"SWEEPSCOPE_STORAGE__DATA_DIR": str(tmp_path), "SWEEPSCOPE_STAGE__KIND": "uno"}
    found = {finding.name: level(finding) for finding in examine(load_config(environ=variables), unreachable, KEYS)}
    assert set(found) >= {"python", "groups", "stage", "firmware", "camera", "space", "disk speed", "calibration"}
    assert set(found) >= {"clock", "sockets", "services", "network"}
    assert found["services"] == "wrong"
