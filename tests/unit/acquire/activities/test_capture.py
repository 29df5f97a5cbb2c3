"""One picture in full size, and another specimen under the simulated camera, while no sweep runs."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from acquire.activities.capture import write_png
from acquire.contract.errors import CommandRefusedError, ScanFileError
from tests.unit.rig_in_process import RigInProcess


@pytest.fixture
def rig(run_dir, tmp_path):
    made = RigInProcess(run_dir, tmp_path / "scans", {}).__enter__()
    yield made
    made.__exit__()


def finished(rig: RigInProcess, what: str) -> dict:
    return rig.until(lambda s: s["activity"] == "" and what in s["message"], f"{what} is over")


def test_a_captured_picture_is_the_cameras_in_full_size(rig, tmp_path):
    rig.ask("lamp", on=True)
    wanted = tmp_path / "scans" / "calibration" / "view-01.png"
    assert rig.ask("capture", path=str(wanted))["path"] == str(wanted)
    assert "saved" in finished(rig, "capture")["message"]
    pixels = cv2.imread(str(wanted), cv2.IMREAD_UNCHANGED)
    assert pixels.shape == (48, 64, 3) and pixels.dtype == np.uint8 and pixels.max() > 0


def test_without_a_path_it_goes_to_the_folder_of_captures(rig, tmp_path):
    path = Path(rig.ask("capture")["path"])
    finished(rig, "capture")
    assert path.parent == tmp_path / "scans" / "captures" and path.is_file()


@pytest.mark.parametrize(
    ("path", "why"),
    [("/etc/x.png", "folder of scans"), ("x.png", "folder of scans"), ("{scans}/../x.png", "folder of scans"),
     ("{scans}/x.h5", "is a .png file"), ("{scans}/there.png", "there already")],
)  # fmt: skip
def test_pictures_go_nowhere_else_and_replace_nothing(rig, tmp_path, path, why):
    (tmp_path / "scans").mkdir(exist_ok=True)
    (tmp_path / "scans" / "there.png").write_bytes(b"mine")
    with pytest.raises(CommandRefusedError, match=why):
        rig.ask("capture", path=path.format(scans=tmp_path / "scans"))
    assert (tmp_path / "scans" / "there.png").read_bytes() == b"mine"


def test_a_picture_that_cannot_be_written_fails_in_words_and_the_rig_goes_on(rig, tmp_path):
    (tmp_path / "scans").mkdir(exist_ok=True)
    (tmp_path / "scans" / "taken").write_bytes(b"a file, not a folder")
    rig.ask("capture", path=str(tmp_path / "scans" / "taken" / "x.png"))
    assert "cannot write" in finished(rig, "capture")["message"]
    assert rig.status()["state"] == "idle"


def test_deep_and_raw_pictures_are_kept_as_they_are_or_made_colour(tmp_path):
    deep = (np.arange(12 * 8, dtype=np.uint16) * 40).reshape(8, 12)
    write_png(tmp_path / "deep.png", deep, "mono")
    assert np.array_equal(cv2.imread(str(tmp_path / "deep.png"), cv2.IMREAD_UNCHANGED), deep)
    write_png(tmp_path / "raw.png", np.full((8, 12), 90, np.uint8), "bayer_rggb")
    assert cv2.imread(str(tmp_path / "raw.png"), cv2.IMREAD_UNCHANGED).shape == (8, 12, 3)
    with pytest.raises(ScanFileError, match="cannot write"):
        write_png(tmp_path / "raw.png" / "x.png", deep, "mono")


def test_another_specimen_lies_under_the_camera_and_the_one_before_can_come_back(rig):
    rig.ask("lamp", on=True)
    rig.ask("goto", position_steps=3000)
    rig.until(lambda s: s["state"] == "idle", "the stage rests")
    assert rig.ask("specimen", object="checkerboard", tilt_x_deg=12.0)["object"] == "checkerboard"
    assert "checkerboard, tilted by 12" in finished(rig, "specimen")["message"]
    camera = rig.daemon.rig.camera
    assert (camera.scene.config.object, camera.scene.config.tilt_x_deg) == ("checkerboard", 12.0)
    board = camera.scene.points_mm.copy()
    rig.ask("specimen", object="stirrup", tilt_x_deg=0.0)
    finished(rig, "specimen: stirrup")
    assert not np.allclose(camera.scene.points_mm, board)


def test_a_real_rig_cannot_change_its_specimen(rig, monkeypatch):
    from acquire.rigs.base import Rig

    monkeypatch.setattr(rig.daemon.rig, "specimen", Rig.specimen.__get__(rig.daemon.rig))
    with pytest.raises(CommandRefusedError, match="by hand"):
        rig.ask("specimen", object="flat")


def test_neither_is_done_while_a_scan_runs(run_dir, tmp_path):
    with RigInProcess(run_dir, tmp_path / "scans", {"limits.writer_start_s": 60.0}) as rig:
        rig.ask("scan", purpose="raw")
        for name in ("capture", "specimen"):
            with pytest.raises(CommandRefusedError, match="a scan is running"):
                rig.ask(name)
