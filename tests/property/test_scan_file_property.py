"""Whatever order frames come in, however often, and whoever comes back: the file holds the first of each, exactly."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.scan_data.checksums import frame_crc32, scan_digest
from acquire.contract.scan_data.reader import ScanReader
from acquire.contract.states import Outcome
from acquire.writer.frame_store import FrameRefusedError
from acquire.writer.scan_file import ScanFile, create_scan
from tests.fakes.scans.frames import image_of, pixels_of, start_of

COUNT = 7
FORMATS = st.builds(
    FrameFormat,
    width=st.integers(1, 9),
    height=st.integers(1, 9),
    bit_depth=st.sampled_from([8, 12, 16]),
    pixel_format=st.sampled_from(["mono", "rgb", "bayer_rggb"]),
)
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("frame"), st.integers(0, COUNT - 1), st.integers(0, 2)),
        st.tuples(st.sampled_from(["sync", "reopen"]), st.just(0), st.just(0)),
    ),
    max_size=25,
)


@settings(max_examples=25, deadline=None)
@given(frame_format=FORMATS, steps=STEPS)
def test_the_first_committed_frame_of_each_index_is_what_the_file_holds(
    frame_format: FrameFormat, steps: list[tuple[str, int, int]]
) -> None:
    model: dict[int, np.ndarray] = {}
    with tempfile.TemporaryDirectory() as folder:
        start = start_of(Path(folder) / "scan", COUNT, frame_format)
        scan = create_scan(Path(start.path), start)
        for step, frame_index, seed in steps:
            if step == "sync":
                scan.sync()
            elif step == "reopen":
                scan.close()
                scan = ScanFile.open_existing(Path(start.path))
            else:
                pixels = pixels_of(frame_index, COUNT, frame_format, seed)
                kept = model.setdefault(frame_index, pixels)
                try:
                    scan.write_frame(image_of(frame_index, pixels, start), pixels)
                    assert np.array_equal(kept, pixels)
                except FrameRefusedError as error:
                    assert error.reason == "immutable" and not np.array_equal(kept, pixels)
        seal = scan.seal(Outcome.COMPLETE if len(model) == COUNT else Outcome.STOPPED)
        scan.close()
        with ScanReader(Path(start.path)) as reader:
            assert {index for index, _ in reader.frames()} == set(model)
            for index, pixels in reader.frames():
                assert np.array_equal(pixels, model[index])
                assert frame_crc32(reader.frame(index)) == reader.field("crc32")[index]
        crc32 = [frame_crc32(model[index]) if index in model else 0 for index in range(COUNT)]
        assert seal.digest == scan_digest(np.array(crc32, dtype=np.uint32))
