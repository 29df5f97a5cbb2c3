"""The page of a scan: opens without a network, says what is there and what is not."""

from __future__ import annotations

import re
from pathlib import Path

import h5py
import msgspec
import pytest

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Image, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.states import Outcome
from acquire.writer.scan_file import create_scan
from process.results.page.figures import two_digits
from process.results.page.html import assess, page, write_page
from process.results.page.load import ScanResults, read_results
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from process.results.write import ResultWriteError
from tests.fakes.processes.sweep_source import calibration_json, edge_frames
from tui.cli import run

WIDTH, HEIGHT, COUNT = 64, 48, 40


def make_scan(folder: Path, *, uid: str = "u1", calibration: bool = True, missing: tuple[int, ...] = ()) -> Path:
    form = FrameFormat(width=WIDTH, height=HEIGHT, bit_depth=8)
    text = calibration_json(WIDTH, HEIGHT) if calibration else ""
    plan = SweepPlan(0, 3 * (COUNT - 1), 3, 3.175)
    user = '{"name": "<frog> & bone", "specimen": "stapes 7"}'
    start = Start(scan_uid=uid, path=str(folder), format=form, plan=plan, calibration_json=text, user_json=user)
    scan = create_scan(folder, start)
    described = {"shape": list(form.shape), "dtype": form.dtype, "bit_depth": 8}
    for k, frame in enumerate(edge_frames(COUNT, WIDTH, HEIGHT)):
        if k not in missing:
            image = Image(scan_uid=uid, frame_index=k, position_um=9.525 * k, crc32=frame_crc32(frame), **described)
            scan.write_frame(image, frame)
    scan.seal(Outcome.STOPPED if missing else Outcome.COMPLETE, "")
    scan.close()
    return folder


@pytest.fixture(scope="module")
def results(tmp_path_factory) -> ScanResults:
    scan = make_scan(tmp_path_factory.mktemp("page") / "scan")
    reconstruct(scan, ReconstructOptions(contrast=30))
    return read_results(scan)


@pytest.fixture(scope="module")
def text(results) -> str:
    return page(results)


def test_the_page_needs_nothing_but_itself_and_holds_all_pictures(text):
    assert len(re.findall(r'src="data:image/png;base64,', text)) == 4
    assert not re.search(r'(src|href)="(?!data:)|url\(|@import|<script', text)
    assert "&lt;frog&gt; &amp; bone" in text and "<frog>" not in text


def test_the_page_says_where_everything_came_from(text, results):
    assert results.report.digest in text and results.report.calibration.sha256 in text
    assert "stapes 7" in text and "from the scan" in text and "SAVED: 40 of 40 frames are safe" in text


@pytest.mark.parametrize(("value", "text"), [(0.2113, "0.21"), (863.2, "860"), (12.4, "12"), (1.0, "1")])
def test_numbers_for_people_have_two_digits_and_no_exponent(value, text):
    assert two_digits(value) == text


def test_every_point_of_the_cloud_stands_at_its_pixel(results):
    assert results.in_cloud.sum() == len(results.cloud) > 500
    crossing = results.maps["crossing"][results.in_cloud]
    assert (crossing.astype("f4") == results.cloud["crossing"]).all()


def test_the_command_writes_the_page_beside_the_results(tmp_path, capsys):
    scan = make_scan(tmp_path / "scan")
    reconstruct(scan, ReconstructOptions(contrast=30))
    assert run(["page", str(scan)]) == 0
    assert (scan / "report.html").stat().st_size > 50_000
    assert str(scan / "report.html") in capsys.readouterr().out


def test_a_scan_without_a_cloud_has_a_page_that_says_why(tmp_path):
    scan = make_scan(tmp_path / "scan", calibration=False)
    reconstruct(scan, ReconstructOptions(contrast=30))
    found = read_results(scan)
    said = assess(found)
    assert said.kind == "bad" and "No points" in said.headline and "no calibration" in said.remarks[0]
    assert page(found).count("<figure>") == 3, "no cross-section"


def test_missing_frames_make_the_verdict_bad_and_remarks_make_it_fair(tmp_path, results):
    scan = make_scan(tmp_path / "scan", missing=(38, 39))
    reconstruct(scan, ReconstructOptions(contrast=30))
    said = assess(read_results(scan))
    assert said.kind == "bad" and "38 of 40" in said.headline
    told = msgspec.structs.replace(results.report, warnings=["12 pixels are odd"])
    fair = assess(ScanResults(results.layout, told, results.maps, results.cloud, results.in_cloud))
    assert fair.kind == "fair" and fair.remarks == ["12 pixels are odd"]


def test_a_scan_without_results_or_with_those_of_another_says_what_to_do(tmp_path):
    scan = make_scan(tmp_path / "scan")
    with pytest.raises(ScanFileError, match="holds no results of scan.h5: make the results again"):
        read_results(scan)
    reconstruct(scan, ReconstructOptions(contrast=30))
    with h5py.File(scan / "maps.h5", "r+") as maps:
        maps.attrs["scan_uid"] = "u2"
    with pytest.raises(ScanFileError, match="made of another scan"):
        read_results(scan)


def test_a_damaged_cloud_is_named(tmp_path):
    scan = make_scan(tmp_path / "scan")
    reconstruct(scan, ReconstructOptions(contrast=30))
    (scan / "cloud.ply").write_bytes(b"ply\nformat nonsense")
    with pytest.raises(ScanFileError, match=r"cloud\.ply is not a readable cloud"):
        read_results(scan)


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path, results, monkeypatch):
    monkeypatch.setattr("process.results.page.html.page", lambda _: "a page")
    with pytest.raises(ResultWriteError, match="cannot write"):
        write_page(tmp_path / "away" / "report.html", results)
