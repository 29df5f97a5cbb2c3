"""Reprocessing a scan file: what it writes, where, what it skips, and what it refuses in one line."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import cv2
import h5py
import msgspec
import numpy as np
import pytest
from plyfile import PlyData

from acquire.contract.errors import CalibrationError, ConfigError, ScanFileError
from acquire.contract.messaging.messages import FrameFormat, Image, Start
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.bayer import demosaiced
from acquire.contract.scan_data.checksums import frame_crc32
from acquire.contract.scan_data.dataset_names import FRAME_FIELDS
from acquire.contract.scan_data.file_layout import read_layout
from acquire.contract.states import Outcome
from acquire.writer.scan_file import create_scan
from process.results.reconstruct import reconstruct
from process.results.settings import ReconstructOptions
from tests.fakes.processes.sweep_source import calibration_json, edge_frames

COUNT, WIDTH, HEIGHT = 40, 64, 48
MakeScan = Callable[..., Path]


@pytest.fixture
def make_scan(tmp_path: Path) -> MakeScan:
    """Writes a scan file as the writer would; ``missing`` frames are never taken."""

    def make(
        frames=None, *, missing=(), pixel_format="mono", calibration=True, outcome=Outcome.COMPLETE, measured=None
    ):
        frames = edge_frames(COUNT, WIDTH, HEIGHT) if frames is None else frames
        form = FrameFormat(
            width=WIDTH, height=HEIGHT, bit_depth=8 if frames[0].dtype == np.uint8 else 12, pixel_format=pixel_format
        )
        plan = SweepPlan(0, 3 * (len(frames) - 1), 3, 3.175)
        text = calibration_json(WIDTH, HEIGHT) if calibration is True else calibration or ""
        folder = tmp_path / "scan"
        file = create_scan(
            folder, Start(scan_uid="u1", path=str(folder), format=form, plan=plan, calibration_json=text)
        )
        for k in set(range(len(frames))) - set(missing):
            image = Image(
                scan_uid="u1",
                frame_index=k,
                position_um=float(plan.positions_um()[k]),
                shape=list(form.shape),
                dtype=form.dtype,
                bit_depth=form.bit_depth,
                pixel_format=pixel_format,
                crc32=frame_crc32(frames[k]),
            )
            file.write_frame(image, frames[k])
        if outcome is not None:
            file.seal(outcome, measured=measured)
        file.close()
        return folder

    return make


def maps_of(folder: Path) -> dict[str, np.ndarray]:
    with h5py.File(folder / "maps.h5") as file:
        return {name: held[()] for name, held in file.items() if isinstance(held, h5py.Dataset)}


def test_maps_are_bit_for_bit_those_of_a_two_pass_reference(make_scan):
    frames = edge_frames(COUNT, WIDTH, HEIGHT, colour=True)
    scan = make_scan(frames, pixel_format="rgb")
    summary = reconstruct(scan, ReconstructOptions(contrast=50, median=3))
    found = maps_of(scan)
    grey = [cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY) for frame in frames]
    expected = two_pass_maps(grey, frames, contrast=50, median=3)
    for name, array in expected.items():
        assert np.array_equal(found[name], array, equal_nan=array.dtype.kind == "f"), name
    whole = np.isfinite(found["crossing"]) & ((found["quality"] & (1 | 2 | 128)) == 0)
    assert summary.complete and summary.points == whole.sum()


def test_what_the_rig_measured_around_the_sweep_comes_from_the_scan_itself(make_scan):
    assert (
        reconstruct(make_scan(measured={"drift_px": 0.25}), ReconstructOptions()).results.report.sweep.drift_px == 0.25
    )


@pytest.mark.parametrize("colour", [False, True])
def test_pixels_that_the_fold_could_not_keep_are_resolved_from_the_file(make_scan, colour):
    rng = np.random.default_rng(3)
    slow = np.linspace(0, 3000, 400)[:, None, None] * rng.uniform(0.2, 1, (HEIGHT, WIDTH))
    grey = np.clip(slow + rng.normal(0, 15, slow.shape), 0, 4095).astype(np.uint16)
    frames = [np.stack([g, g // 2, g // 4], axis=2) if colour else g for g in grey]
    scan = make_scan(frames, pixel_format="rgb" if colour else "mono")
    counts = reconstruct(scan, ReconstructOptions(contrast=50, median=0)).results.report.counts
    assert counts["quality_from_file"] > 100 and counts["unresolved"] == 0
    seen = [cv2.cvtColor(f, cv2.COLOR_RGB2GRAY) if colour else f for f in frames]
    expected = two_pass_maps(seen, frames if colour else list(grey), contrast=50 * 16, median=0)["crossing"]
    assert np.array_equal(maps_of(scan)["crossing"], expected, equal_nan=True)


def two_pass_maps(grey, frames, *, contrast, median) -> dict[str, np.ndarray]:
    stack = np.stack(grey).astype(np.int64)
    low, high = stack.min(axis=0), stack.max(axis=0)
    mask = (high - low >= contrast).astype(np.uint8)
    mask = cv2.medianBlur(mask, median) if median else mask
    crossing = np.full(low.shape, np.nan)
    for y, x in zip(*np.nonzero(mask), strict=True):
        column = stack[:, y, x]
        over = np.flatnonzero(2 * column >= low[y, x] + high[y, x])
        if len(over) and (m := over[0]) > 0:
            half = (low[y, x] + high[y, x]) / 2
            crossing[y, x] = (m - 1) + (half - column[m - 1]) / (column[m] - column[m - 1])
    first_maximum = stack.argmax(axis=0)
    rows, columns = np.indices(low.shape)
    return {
        "min": low.astype(np.uint8),
        "max": high.astype(np.uint8),
        "mask": mask,
        "crossing": crossing,
        "colour": np.stack(frames)[first_maximum, rows, columns],
    }


def test_results_go_beside_the_scan_file_or_where_they_are_asked_for(make_scan, tmp_path):
    scan = make_scan()
    reconstruct(scan / "scan.h5", ReconstructOptions(out=tmp_path / "new" / "place"))
    assert not (scan / "maps.h5").exists()
    names = sorted(path.name for path in (tmp_path / "new" / "place").iterdir())
    assert names == ["cloud.ply", "maps.h5", "report.json"]


def test_twice_gives_the_same_bytes_of_cloud_and_the_same_maps(make_scan):
    scan = make_scan()
    reconstruct(scan, ReconstructOptions())
    first, maps = (scan / "cloud.ply").read_bytes(), maps_of(scan)
    reconstruct(scan, ReconstructOptions())
    assert (scan / "cloud.ply").read_bytes() == first
    assert all(np.array_equal(maps[k], v, equal_nan=v.dtype.kind == "f") for k, v in maps_of(scan).items())


def test_maps_carry_the_settings_they_were_made_with(make_scan):
    scan = make_scan()
    reconstruct(scan, ReconstructOptions(contrast=44, median=0))
    with h5py.File(scan / "maps.h5") as file:
        attributes = dict(file.attrs)
    assert (attributes["contrast"], attributes["median"], attributes["edge"]) == (44, 0, "rising")
    assert attributes["method"] == "linear" and attributes["folded_through"] == COUNT - 1
    assert len(attributes["source_digest"]) == 64


def test_missing_frames_are_skipped_and_the_scan_is_not_complete(make_scan):
    scan = make_scan(missing=(7, 8, COUNT - 1), outcome=Outcome.STOPPED)
    summary = reconstruct(scan, ReconstructOptions())
    counts = summary.results.report.counts
    assert not summary.complete and summary.outcome_text == f"stopped: {COUNT - 3} of {COUNT} frames are safe"
    assert (counts["missing"], counts["quality_missing_neighbour"] > 0) == (3, True)


def test_a_scan_that_still_runs_is_reconstructed_as_far_as_it_is(make_scan):
    scan = make_scan(missing=range(20, COUNT), outcome=None)
    summary = reconstruct(scan, ReconstructOptions(contrast=50))
    assert summary.outcome == "running" and not summary.complete
    assert summary.results.report.counts["committed"] == 20


def test_a_frame_without_its_checksum_is_left_out_and_named(make_scan):
    scan = make_scan()
    layout = read_layout(scan)
    with (scan / "scan.h5").open("r+b") as file:
        file.seek(layout.frame_offset(11))
        file.write(b"\x00" * 100)
    summary = reconstruct(scan, ReconstructOptions())
    assert not summary.complete
    assert "1 frames do not have their checksum and were left out: 11" in summary.warnings[0]


def test_without_a_calibration_there_are_maps_no_cloud_and_a_reason(make_scan):
    scan = make_scan(calibration=None)
    summary = reconstruct(scan, ReconstructOptions())
    assert summary.points is None and not (scan / "cloud.ply").exists() and (scan / "maps.h5").exists()
    assert "no calibration" in summary.warnings[0] and len(summary.warnings) == 1


def test_a_cloud_of_an_earlier_run_is_named_when_this_run_makes_none(make_scan):
    scan = make_scan(calibration=None)
    (scan / "cloud.ply").write_text("old")
    assert "left from an earlier run" in reconstruct(scan, ReconstructOptions()).warnings[1]
    assert (scan / "cloud.ply").read_text() == "old"


def test_positions_that_are_not_known_are_refused_for_a_plane_by_position(make_scan):
    scan = make_scan()
    layout = read_layout(scan)
    with (scan / "scan.h5").open("r+b") as file:
        file.seek(layout.regions["position_um"].offset)
        file.write(np.full(COUNT, np.nan, FRAME_FIELDS["position_um"]).tobytes())
    with pytest.raises(CalibrationError, match="does not know its positions"):
        reconstruct(scan, ReconstructOptions())


def test_a_scan_without_a_single_frame_is_refused(make_scan):
    with pytest.raises(ScanFileError, match="nothing to reconstruct"):
        reconstruct(make_scan(missing=range(COUNT), outcome=None), ReconstructOptions())


def test_a_truncated_file_is_refused_in_one_line(make_scan):
    scan = make_scan()
    with (scan / "scan.h5").open("r+b") as file:
        file.truncate(10_000)
    with pytest.raises(ScanFileError) as caught:
        reconstruct(scan, ReconstructOptions())
    assert "\n" not in str(caught.value) and "scan.h5" in str(caught.value)


def test_a_folder_for_results_that_cannot_be_made_is_named(make_scan, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigError, match="--out"):
        reconstruct(make_scan(), ReconstructOptions(out=tmp_path / "file" / "x"))


def test_what_only_a_report_says_of_the_rig_is_carried_over_when_the_same_frames_are_processed_again(make_scan):
    scan = make_scan()
    reconstruct(scan, ReconstructOptions())
    text = (scan / "report.json").read_bytes()
    fields = msgspec.json.decode(text)
    fields["sweep"]["drift_px"] = 0.75
    (scan / "report.json").write_bytes(msgspec.json.encode(fields))
    again = reconstruct(scan, ReconstructOptions(contrast=30))
    assert again.results.report.sweep.drift_px == 0.75


def test_bayer_frames_are_demosaiced_on_reading(make_scan):
    colour = edge_frames(COUNT, WIDTH, HEIGHT, colour=True)
    raw = []
    for frame in colour:
        mosaic = frame[:, :, 1].copy()
        mosaic[0::2, 0::2] = frame[0::2, 0::2, 0]
        mosaic[1::2, 1::2] = frame[1::2, 1::2, 2]
        raw.append(mosaic)
    scan = make_scan(raw, pixel_format="bayer_rggb")
    summary = reconstruct(scan, ReconstructOptions(contrast=50))
    rgb = summary.results.cloud.rgb.astype(float).mean(axis=0)
    assert rgb[0] > rgb[1] > rgb[2], "the light is tinted: red 1.0, green 0.9, blue 0.7"
    assert demosaiced(raw[0], "bayer_rggb").shape == (HEIGHT, WIDTH, 3)


def test_twelve_bit_frames_give_the_same_points_as_their_eight_bits(make_scan, tmp_path):
    frames = edge_frames(COUNT, WIDTH, HEIGHT)
    eight = reconstruct(make_scan(frames), ReconstructOptions(contrast=50))
    (tmp_path / "scan").rename(tmp_path / "eight")
    twelve = reconstruct(make_scan([f.astype(np.uint16) * 16 for f in frames]), ReconstructOptions(contrast=50))
    assert twelve.points == eight.points
    assert np.allclose(twelve.results.cloud.points_mm, eight.results.cloud.points_mm, atol=1e-9)
    written = PlyData.read(str(twelve.paths.cloud))["vertex"]
    assert len(written) == twelve.points


def test_options_are_immutable():
    with pytest.raises(dataclasses.FrozenInstanceError):
        ReconstructOptions().contrast = 3  # type: ignore[misc]


def test_a_falling_edge_is_found_where_nobody_said_which(make_scan):
    scan = make_scan([255 - frame for frame in edge_frames(COUNT, WIDTH, HEIGHT)], calibration=False)
    summary = reconstruct(scan, ReconstructOptions(contrast=50))
    report = summary.results.report
    assert report.settings["edge"] == "falling" and report.counts["crossings"] > 1000 and not summary.nothing
    assert any("taken for a falling one" in words for words in summary.warnings)


def test_an_edge_that_was_asked_for_is_kept_and_the_other_one_named(make_scan):
    scan = make_scan([255 - frame for frame in edge_frames(COUNT, WIDTH, HEIGHT)], calibration=False)
    summary = reconstruct(scan, ReconstructOptions(contrast=50, edge="rising"))
    assert summary.results.report.counts["crossings"] == 0 and "--edge falling" in summary.nothing
    assert summary.warnings[0] == summary.nothing and not any("%" in words for words in summary.warnings)


def test_a_few_stray_crossings_of_the_wrong_edge_do_not_hide_the_other_one(make_scan):
    frames = [255 - frame for frame in edge_frames(COUNT, WIDTH, HEIGHT)]
    for index, frame in enumerate(frames):
        frame[:4, :4] = 20 if index < 2 else 200
    summary = reconstruct(make_scan(frames), ReconstructOptions(contrast=50, method="linear", edge="rising"))
    assert summary.results.report.counts["crossings"] > 0
    assert "--edge falling" in (summary.nothing or " ".join(summary.warnings))


def test_a_rising_edge_stays_rising(make_scan):
    summary = reconstruct(make_scan(calibration=False), ReconstructOptions(contrast=50))
    assert summary.results.report.settings["edge"] == "rising" and not summary.nothing


@pytest.mark.parametrize(
    ("frames", "options", "said"),
    [
        (edge_frames(COUNT, WIDTH, HEIGHT), {"contrast": 255}, "try --contrast"),
        ([np.full((HEIGHT, WIDTH), 60, np.uint8)] * COUNT, {}, "does the light sweep"),
        ([frame.astype(np.uint16) for frame in edge_frames(COUNT, WIDTH, HEIGHT)], {}, "--bit-depth"),
    ],
)
def test_a_result_without_a_crossing_says_why_and_what_to_try(make_scan, frames, options, said):
    summary = reconstruct(make_scan(frames), ReconstructOptions(**options))
    assert summary.points == 0 and said in summary.nothing


def test_a_calibration_of_other_frames_is_the_reason_for_no_point(make_scan):
    text = json.loads(calibration_json(WIDTH, HEIGHT))
    planes = [[1.0, 0.0, 0.0, 0.001 * k] for k in range(5)]
    text["light_plane"] = {"kind": "per-frame", "parameter": "frame", "first_frame": 500, "planes": planes}
    summary = reconstruct(make_scan(calibration=json.dumps(text)), ReconstructOptions(contrast=50))
    assert summary.points == 0 and "has planes for 500 to 504" in summary.nothing
