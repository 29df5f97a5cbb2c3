"""Owns one scan in the worker: what was announced, the cursor, the previews, the results. No sockets in here."""

from __future__ import annotations

import dataclasses
import logging
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import End, Image, ResultProgress, Status
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.scan_data.bayer import demosaiced
from acquire.contract.states import SEALED_OUTCOMES
from acquire.contract.units import NS_PER_MS
from process.cloud.triangulation import rays
from process.results.final_maps import new_fold
from process.results.fold_cursor import FoldCursor
from process.results.scan_frames import ScanFrames, open_frames
from process.results.timings import Timings
from process.results.write import Results, refresh_report, results_on_disk, write_results

from .fit_ahead import Ahead
from .frame_check import LiveGate
from .provisional_cloud import Preview, ShownCounts, make_preview
from .scan_description import Announced, check_memory, live_settings
from .scan_end import Ending

logger = logging.getLogger(__name__)

BUFFER_BYTES = 64_000_000
"""Live frames that may wait for a gap to be filled."""
SILENT_NS = 250 * NS_PER_MS
"""After so long without a frame the file is asked; what is there for so long again was lost on the live lane."""
FILE_BYTES_AT_ONCE = 16_000_000
"""Frames read from the file before the sockets are looked at again: some 10 ms, or one frame."""


class ScanSession:
    """Folds one scan, from the live lane and from its file, in whatever order they come."""

    def __init__(self, announced: Announced, fold_bytes: int, clock: Clock | None = None) -> None:
        """Take the memory of the fold.

        Raises:
            ScanRefusedError: the fold does not fit into ``fold_bytes``.
        """
        self.announced = announced
        self.form = announced.recorded.format
        self.settings = live_settings(announced.recorded)
        check_memory(self.form, fold_bytes)
        # of this scan's values, not of this object: a cycle would keep fold and mapped file until the collector comes
        settings, form = self.settings, self.form
        room = min(max(BUFFER_BYTES // self.form.nbytes, 4), 64)
        self.cursor = FoldCursor(lambda: new_fold(settings, form, announced.count), announced.count, room)
        self._ahead = Ahead(self.settings, self.form)
        self._file_frames = max(1, FILE_BYTES_AT_ONCE // self.form.nbytes)
        self.gate = LiveGate(announced)
        self.timings = Timings()
        self.results: Results | None = None
        self.failure = ""
        """Why there are no results, in words; empty while there is hope."""
        self.end_said = False
        """The end was told on the results lane."""
        self.seconds_to_disk = 0.0
        self.newest_live = -1
        self._clock = clock or MonotonicClock()
        self.last_frame_ns = self._clock.now_ns()
        """When the newest frame was folded, CLOCK_MONOTONIC."""
        self.shown = ShownCounts()
        self._spotted = (-1, 0)
        self._left_alone = False
        self._ending = Ending()
        self._frames: ScanFrames | None = None
        self._position_um = announced.planned_positions_um
        if self.settings.calibration and self.settings.light_plane:
            rays(self.settings.calibration.camera)  # half a second that must not be spent after the last frame

    @property
    def folder(self) -> Path:
        """The scan's folder."""
        return self.announced.folder

    def close(self) -> None:
        """Close the scan file; idempotent."""
        if self._frames is not None:
            self._frames.close()
            self._frames = None

    # ---- what comes in ----

    @property
    def ended(self) -> bool:
        """The rig has said how the scan ended."""
        return self._ending.known

    @property
    def outcome(self) -> str:
        """As the rig said; ``running`` before."""
        return self._ending.outcome

    def take_image(self, image: Image, payload: memoryview) -> bool:
        """Fold a live frame if it is whole and its turn has come; True if the fold went on."""
        if not self.gate.is_of_this_sweep(image):
            return False
        self.newest_live = max(self.newest_live, image.frame_index)
        if not self.cursor.wants(image.frame_index):
            return False
        pixels = self.gate.pixels(image, payload)
        if pixels is None:
            return False
        self._position_um[image.frame_index] = image.position_um
        with self.timings.stage("fold_live"):
            return self._offer(image.frame_index, image.crc32, demosaiced(pixels, self.form.pixel_format))

    def take_end(self, end: End) -> None:
        """The rig's account of the scan."""
        self._ending = Ending.of(end)

    def take_status(self, status: Status) -> None:
        """Learn of an end whose message was lost on the live lane."""
        if not self.ended and status.scan_uid == self.announced.scan_uid and status.outcome in SEALED_OUTCOMES:
            self._ending = Ending(status.outcome)

    def _offer(self, frame_index: int, crc32: int, pixels: NDArray[np.generic]) -> bool:
        try:
            went_on = self.cursor.offer(frame_index, crc32, pixels)
        except Exception:  # noqa: BLE001 - whatever a poisonous frame does, the file has the truth: fold it anew (F08)
            logger.exception("frame %d could not be folded: folding the scan file again", frame_index)
            self.gate.counts.raised += 1
            self.cursor.restart()
            return False
        if went_on:
            self.last_frame_ns = self._clock.now_ns()
        return went_on

    # ---- the file ----

    @property
    def behind(self) -> bool:
        """Frames were taken that are not folded, and they will not come on the live lane."""
        return not self.cursor.done and self.lag_frames > 0

    @property
    def wants_file(self) -> bool:
        """Time to look into the file: frames are known to be there, or the live lane has fallen silent."""
        silent_ns = self._clock.now_ns() - self.last_frame_ns
        return not self.cursor.done and (self.behind or silent_ns > SILENT_NS)

    def catch_up(self) -> None:
        """Take the frames that are in the file already from there (after a late start)."""
        frames = self.frames()
        if frames is not None:
            self.newest_live = max(self.newest_live, int(frames.usable().sum()) - 1)

    def fill(self) -> int:
        """Fold a few frames from the file where the live lane left a gap; returns how many were read."""
        frames = self.frames()
        if frames is None or self.cursor.done or not (self.behind or self._overdue(frames)):
            return 0
        before = self.cursor.next_index
        with self.timings.stage("fold_file"):
            # not beyond the newest live frame: those that follow it are on their way
            through = self.announced.count if self.ended else max(self.newest_live, before)
            never = self._ending.never(self.announced.count, frames.outcome)
            read = self.cursor.fill(frames, limit=self._file_frames, through=through, never=never)
        if read:
            self.last_frame_ns = self._clock.now_ns()
            filled = slice(before, self.cursor.next_index)
            known = frames.usable()[filled]
            self._position_um[filled][known] = frames.positions_um()[filled][known]
        return read

    def _overdue(self, frames: ScanFrames) -> bool:
        """The next frame is in the file for so long that it must have been lost on the live lane."""
        frame_index, now_ns = self.cursor.next_index, self._clock.now_ns()
        if not frames.usable()[frame_index]:
            return False
        if self._spotted[0] != frame_index:
            self._spotted = (frame_index, now_ns)
        return now_ns - self._spotted[1] >= SILENT_NS

    def frames(self) -> ScanFrames | None:
        """The scan file; None while the writer has not made it."""
        if self._frames is None:
            self._frames = open_frames(self.announced.folder, self.announced.scan_uid)
        return self._frames

    # ---- what goes out ----

    def preview(self) -> Preview | None:
        """The points now; None before the first frame."""
        if not self.cursor.folded.any():
            return None
        preview = make_preview(self.cursor, self.settings, self._position_um)
        if preview.maps is not None:
            self._ahead.propose(preview.maps, self.cursor, self.frames())
        self.shown = preview.counts
        return preview

    def progress(self, version: int) -> ResultProgress:
        """How far the fold is, in numbers and words."""
        counts = self.cursor.counts
        return ResultProgress(
            scan_uid=self.announced.scan_uid,
            version=version,
            folded_through=self.cursor.fold.folded_through,
            expected=self.announced.count,
            over_contrast=self.shown.over_contrast,
            points_settled=self.shown.settled,
            points_provisional=self.shown.provisional,
            from_live=counts.from_live,
            from_file=counts.from_file,
            refolded=counts.refolded,
            lag_frames=self.lag_frames,
            message=self._words(),
        )

    @property
    def lag_frames(self) -> int:
        """Frames that were taken, as far as the live lane tells, and are not folded yet; after the end all of these."""
        taken = self.announced.count if self.ended else self.newest_live + 1
        return max(taken - self.cursor.next_index, 0)

    def _words(self) -> str:
        if self.failure:
            return self.failure
        if self.behind and self.frames() is None:
            return "waiting for the writer to make the scan file"
        if self.behind:
            return f"reading frame {self.cursor.next_index} from the scan file"
        return "; ".join([*self.settings.warnings, *filter(None, [self.settings.what_is_missing])])

    @property
    def may_work_ahead(self) -> bool:
        """Estimates can be made now that are then not left to the end."""
        return self._ahead.busy

    def work_ahead(self) -> None:
        """Make a few of them: some milliseconds."""
        with self.timings.stage("estimate_early"):
            self._ahead.work(self.cursor)

    # ---- the end ----

    def ready_to_finish(self) -> bool:
        """Every frame is folded or known to be missing, and those folded are in the file."""
        if self.results is not None or self.failure or not self.cursor.done:
            return False
        frames = self.frames()
        return frames is not None and (self.ended or bool(frames.usable().all()))

    def finish(self) -> Results:
        """Compare the fold with the file, fold again what differs, and write the results beside the scan file.

        A worker that was started after the scan finds results there already; it leaves them alone.

        Raises:
            ScanFileError, CalibrationError, ResultWriteError: as ``outputs.write_results``.
        """
        frames = self.frames()
        assert frames is not None
        if self.cursor.counts.from_live == 0:
            self.results = results_on_disk(self.cursor, frames, self.settings)
            if self.results is not None:
                self._left_alone = True
                self._show_all(self.results)
                return self.results
        with self.timings.stage("compare"):
            different = self.cursor.differs_from(frames)
        if different:
            logger.warning(
                "%d frames differ from the scan file (first: %d): folding anew", len(different), different[0]
            )
            self.cursor.restart()
            everything = np.ones(self.announced.count, np.bool_)
            with self.timings.stage("refold"):
                self.cursor.fill(frames, limit=self.announced.count, never=everything)
        self.results = write_results(
            self.cursor,
            frames,
            self.settings,
            frames.layout.path.parent,
            outcome=self.outcome,
            checks=self._ending.checks,
            timings=self.timings,
            compare=False,
            more_counts=self.gate.counts.named(),
            early=self._ahead.estimates(self.cursor),
        )
        self._show_all(self.results)
        return self.results

    def _show_all(self, results: Results) -> None:
        points = 0 if results.cloud is None else len(results.cloud)
        self.shown = ShownCounts(results.report.counts["over_contrast"], points, 0)

    def refresh(self) -> bool:
        """Bring a finished report up to date: outcome, digest and truth may be known only later; True if it changed.

        Raises:
            ScanFileError, ResultWriteError: as :meth:`finish`.
        """
        frames = self.frames()
        if self.results is None or frames is None or self._left_alone:
            return False
        if self.ended and self.cursor.differs_from(frames):
            self.finish()
            return True
        report = refresh_report(self.results, frames, self.settings, self.outcome, self._ending.checks)
        if report == self.results.report:
            return False
        self.results = dataclasses.replace(self.results, report=report)
        return True
