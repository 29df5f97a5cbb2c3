"""Files that people hand in, cut short or with flipped bits: one error class with one line, never a crash or a hang."""

from __future__ import annotations

import json
import random
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from acquire.contract.calibration import load_calibration, parse_calibration
from acquire.contract.config.load import load_config
from acquire.contract.errors import CalibrationError, ConfigError, SweepscopeError
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.importing.folder import import_folder
from acquire.writer.recover import recover
from acquire.writer.scan_file import create_scan
from acquire.writer.verify import verify
from tests import ROOT
from tests.fakes.scans.frames import image_of, pixels_of, start_of
from tests.waiting import run

COUNT = 6
json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(st.text(max_size=8), inner, max_size=5),
    max_leaves=20,
)
quick = settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture(scope="module")
def sealed(tmp_path_factory) -> bytes:
    folder = tmp_path_factory.mktemp("sealed") / "scan"
    start = start_of(folder, COUNT)
    scan = create_scan(folder, start)
    for frame_index in range(COUNT):
        pixels = pixels_of(frame_index, COUNT, start.format)
        scan.write_frame(image_of(frame_index, pixels, start), pixels)
    scan.seal(Outcome.COMPLETE)
    scan.close()
    return (folder / "scan.h5").read_bytes()


def assert_survives(path: Path) -> str:
    """Verifying ends with a report or with one line; whatever is called sound is sound."""
    try:
        report = verify(path)
    except SweepscopeError as error:
        assert "\n" not in str(error)
        return "refused"
    return "sound" if report.ok else "damaged"


def test_a_scan_cut_short_at_any_byte_is_refused_or_named_as_damaged(sealed, tmp_path):
    source, path = random.Random(1), tmp_path / "scan.h5"
    cuts = {*range(0, 200, 7), *(source.randrange(len(sealed)) for _ in range(150)), len(sealed) - 1}
    for cut in sorted(cuts):
        path.write_bytes(sealed[:cut])
        assert assert_survives(path) != "sound", f"cut at byte {cut}"


def test_a_partial_scan_cut_short_is_never_recovered_into_something_it_is_not(sealed, tmp_path):
    source, path = random.Random(2), tmp_path / "scan.partial.h5"
    for cut in [0, 1, *(source.randrange(len(sealed)) for _ in range(40))]:
        path.write_bytes(sealed[:cut])
        (found,) = recover(tmp_path)
        assert found.state == "unreadable" and path.stat().st_size == cut


def test_flipped_bits_in_the_pixels_are_always_found(sealed, tmp_path):
    source, path = random.Random(3), tmp_path / "scan.h5"
    path.write_bytes(sealed)
    with ScanReader(path) as reader:
        first, size = reader.layout.frame_offset(0), COUNT * reader.layout.frame_nbytes
    for _ in range(60):
        spoiled = bytearray(sealed)
        spoiled[first + source.randrange(size)] ^= 1 << source.randrange(8)
        path.write_bytes(spoiled)
        assert assert_survives(path) == "damaged"


_FLIP = """
import random, sys
from pathlib import Path
from tests.faults.test_hostile_files import assert_survives
whole, path, source = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2]), random.Random(int(sys.argv[3]))
for _ in range(int(sys.argv[4])):
    spoiled = bytearray(whole)
    for _ in range(source.choice([1, 1, 8])):
        spoiled[source.randrange(6000)] ^= 1 << source.randrange(8)
    path.write_bytes(spoiled)
    assert_survives(path)
"""


def test_flipped_bits_in_the_structure_crash_nobody(sealed, tmp_path):
    """In a process of its own, because the library that reads HDF5 is C: a crash there would take the tests along."""
    import sys

    (tmp_path / "whole").write_bytes(sealed)
    arguments = [str(tmp_path / "whole"), str(tmp_path / "scan.h5"), "4", "200"]
    done = run([sys.executable, "-c", _FLIP, *arguments], cwd=ROOT)
    assert done.returncode == 0, done.stderr[-2000:]


@quick
@given(json_values)
def test_any_json_as_calibration_is_accepted_or_refused_in_one_line(value):
    try:
        parse_calibration(json.dumps(value), "the file")
    except CalibrationError as error:
        assert "\n" not in str(error)


GOOD = {
    "format": "sweepscope-calibration",
    "version": 1,
    "camera": {
        "width": 64, "height": 48, "K": [[100, 0, 32], [0, 100, 24], [0, 0, 1]], "distortion": [0, 0, 0, 0, 0],
        "R": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "T": [0, 0, 80],
    },
    "light_plane": {
        "kind": "translating", "parameter": "position_um", "edge": "rising", "normal": [1, 0, 0],
        "corner_origin_mm": [0, 0, 0], "corner_velocity_mm": [0.001, 0, 0], "velocity_direction": "normal",
    },
}  # fmt: skip


@quick
@given(st.sampled_from(["camera", "light_plane"]), st.data(), json_values)
def test_a_calibration_with_one_wild_value_is_accepted_or_refused_in_one_line(section, data, value):
    spoiled = json.loads(json.dumps(GOOD))
    spoiled[section][data.draw(st.sampled_from(sorted(spoiled[section])))] = value
    try:
        parse_calibration(json.dumps(spoiled), "the file")
    except CalibrationError as error:
        assert "\n" not in str(error)


@quick
@given(st.binary(max_size=300))
def test_any_bytes_as_calibration_or_configuration_are_refused_in_one_line(tmp_path, raw):
    path = tmp_path / "file"
    path.write_bytes(raw)
    with pytest.raises(CalibrationError) as refused:
        load_calibration(path)
    assert "\n" not in str(refused.value)
    try:
        load_config(str(path), environ={})
    except ConfigError as error:
        assert "\n" not in str(error)


@quick
@given(st.sampled_from(["camera", "stage", "storage", "limits", "sweep", "simulation"]), st.data(), json_values)
def test_a_configuration_with_one_wild_value_is_accepted_or_refused_in_one_line(section, data, value):
    import tomli_w

    from acquire.contract.config.model import RigConfig

    key = data.draw(st.sampled_from(sorted(getattr(RigConfig(), section).__struct_fields__)))
    try:
        text = tomli_w.dumps({section: {key: value}})
    except (TypeError, ValueError):
        return  # TOML has no null
    variable = {f"SWEEPSCOPE_{section.upper()}__{key.upper()}": text.partition("=")[2].strip()}
    try:
        load_config(environ=variable)
    except ConfigError as error:
        assert "\n" not in str(error)


def test_a_folder_with_a_picture_cut_short_is_refused_by_its_name(tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    for k in range(4):
        cv2.imwrite(str(frames / f"{k}.png"), np.full((20, 30), 10 * k, np.uint8))
    whole = (frames / "2.png").read_bytes()
    for cut in (0, 1, 8, 20, len(whole) // 2):
        (frames / "2.png").write_bytes(whole[:cut])
        with pytest.raises(SweepscopeError, match="2.png"):
            import_folder(frames, tmp_path / "scan.h5")
        assert not (tmp_path / "scan.h5").exists()


def _bent(source: random.Random, whole: bytes) -> bytes:
    """Cut short, bits flipped, a piece doubled or left out, or something else altogether."""
    at, length = source.randrange(len(whole)), source.randrange(1, 40)
    match source.randrange(5):
        case 0:
            return whole[:at]
        case 1:
            return bytes(byte ^ (1 << source.randrange(8)) if source.random() < 0.01 else byte for byte in whole)
        case 2:
            return whole[:at] + whole[at : at + length] * 2 + whole[at + length :]
        case 3:
            return whole[:at] + whole[at + length :]
        case _:
            return source.randbytes(len(whole))


_BEND = """
import random, sys
from pathlib import Path
from tests.faults.test_hostile_files import import_or_refuse
frames, source = Path(sys.argv[1]), random.Random(int(sys.argv[2]))
outcomes = [import_or_refuse(frames, source) for _ in range(int(sys.argv[3]))]
print(outcomes.count("refused"), outcomes.count("imported"))
"""


def import_or_refuse(frames: Path, source: random.Random) -> str:
    """Bend one picture of a folder, import it, and put the picture back as it was."""
    from acquire.pictures.reader import read_picture

    picture = source.choice(sorted(frames.iterdir()))
    whole, target = picture.read_bytes(), frames.parent / "scan.h5"
    picture.write_bytes(_bent(source, whole))
    try:
        import_folder(frames, target)
    except SweepscopeError as error:
        assert "\n" not in str(error) and not target.exists()
        return "refused"
    else:
        # what was taken for a picture is in the scan as it was read, and the scan is sound
        assert verify(target).complete
        pictures = sorted(frames.iterdir())
        with ScanReader(target) as reader:
            assert np.array_equal(reader.frame(pictures.index(picture)), read_picture(picture))
        target.unlink()
        return "imported"
    finally:
        picture.write_bytes(whole)


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_a_folder_with_a_bent_picture_is_refused_in_one_line_or_imported_as_it_is_read(suffix, tmp_path):
    """In a process of its own, because the decoders are C."""
    import sys

    frames = tmp_path / "frames"
    frames.mkdir()
    shades = np.random.default_rng(1).integers(0, 255, (20, 30), dtype=np.uint8)
    for k in range(3):
        cv2.imwrite(str(frames / f"{k}.{suffix}"), shades // (k + 1))
    done = run([sys.executable, "-c", _BEND, str(frames), "7", "25"], cwd=ROOT)
    assert done.returncode == 0, done.stderr[-2000:]
    refused, _imported = map(int, done.stdout.split())
    assert refused > 5


PLY_HEADERS = (
    "ply\nformat binary_little_endian 1.0\nelement vertex 999999999999\nproperty float x\nend_header\n",
    "ply\nformat binary_little_endian 1.0\nelement vertex 99999999999999999999999\nproperty float x\nend_header\n",
    "ply\nformat ascii 1.0\nelement vertex 2\nproperty list uchar int x\nend_header\n1 1\n",
    "ply\nformat binary_little_endian 1.0\nelement vertex 1\nproperty list uint float x\nend_header\n\xff\xff\xff\xff",
    "ply\nformat binary_little_endian 1.0\nelement vertex -1\nproperty float x\nend_header\n",
    "ply\nend_header\n",
    "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float x\nend_header\n1 1\n",
)


def test_a_bent_cloud_is_opened_as_it_is_or_refused_in_one_line(tmp_path):
    from plyfile import PlyData, PlyElement

    from process.cloud.ply import VERTEX, read_vertices
    from process.viewer.exports.results_list import ListedScan, open_scan

    path, source = tmp_path / "cloud.ply", random.Random(5)
    PlyData([PlyElement.describe(np.zeros(50, VERTEX), "vertex")], byte_order="<").write(str(path))
    whole, refused = path.read_bytes(), 0
    bent = [*(header.encode("latin-1") for header in PLY_HEADERS), *(_bent(source, whole) for _ in range(300))]
    for raw in bent:
        path.write_bytes(raw)
        for opened in (lambda: read_vertices(path, instead=""), lambda: open_scan(ListedScan(tmp_path, "x", "", None))):
            try:
                opened()
            except SweepscopeError as error:
                refused += 1
                assert "\n" not in str(error)
    assert refused > 100
