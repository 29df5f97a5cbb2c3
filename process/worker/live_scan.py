"""One scan while it is reconstructed live: frames in; points, progress and results out as values. No sockets here."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
from numpy.typing import NDArray

from acquire.contract.messaging.messages import End, Image, ResultEnd, ResultProgress, Status
from acquire.contract.process.clocks import Clock, MonotonicClock
from acquire.contract.scan_data.bayer import demosaiced
from acquire.contract.scan_data.dataset_names import PARTIAL_NAME
from acquire.contract.states import SEALED_OUTCOMES
from acquire.contract.units import NS_PER_MS, NS_PER_S
from process.cloud.triangulation import rays
from process.results.final_maps import new_fold
from process.results.fold_cursor import FoldCursor
from process.results.scan_frames import ScanFrames, open_frames
from process.results.timings import Timings
from process.results.write import Results, refresh_report, results_on_disk, write_results

from .early_fits import EarlyFits
from .frame_check import FrameCheck
from .provisional_cloud import PointCounts, ProvisionalCloud, provisional_cloud
from .scan_description import ScanDescription, ScanEnd, check_memory, live_settings

logger = logging.getLogger(__name__)

BUFFER_BYTES = 64_000_000
"""Live frames that may wait for a gap to be filled."""
SILENT_NS = 250 * NS_PER_MS
"""After so long without a frame the file is asked; what is there for so long again was lost on the live lane."""
FILE_BYTES_AT_ONCE = 16_000_000
"""Frames read from the file before the sockets are looked at again: some 10 ms, or one frame."""


class LiveScan:
    """Folds one scan, from the live lane and from its file, in whatever order the frames come."""

    def __init__(self, description: ScanDescription, fold_bytes: int, clock: Clock | None = None) -> None:
        """Take the memory of the fold.

        Raises:
            ScanRefusedError: the fold does not fit into ``fold_bytes``.
        """
        self.description = description
        self.form = description.recorded.format
        self.settings = live_settings(description.recorded)
        check_memory(self.form, fold_bytes)
        # local names in the lambda, not self: a cycle would keep fold and mapped file until the collector comes
        settings, form, count = self.settings, self.form, description.count
        buffered = min(max(BUFFER_BYTES // form.nbytes, 4), 64)
        self.cursor = FoldCursor(lambda: new_fold(settings, form, count), count, buffered)
        self.check = FrameCheck(description)
        self.timings = Timings()
        self.results: Results | None = None
        self.failure = ""
        """Why there are no results, for the user; empty before a failure and while it is tried again."""
        self.seconds_to_disk = 0.0
        """From the last frame to the results on disk."""
        self.end = ScanEnd()
        self.ended = False
        """The rig has reported how the scan ended."""
        self._early = EarlyFits(settings, form)
        self._clock = clock or MonotonicClock()
        self._last_frame_ns = self._clock.now_ns()
        """When the newest frame was folded, CLOCK_MONOTONIC."""
        self._newest_live = -1
        self._counts = PointCounts()
        self._seen_in_file = (-1, 0)
        """A frame index that the live lane did not bring, and when it was first seen in the file."""
        self._left_alone = False
        """The results were there before this worker."""
        self._frames: ScanFrames | None = None
        self._status_is_old = description.reopened
        """The status may still be of the time when the scan was stopped, until it says that the scan runs."""
        self._position_um = description.planned_positions_um
        if settings.calibration and settings.light_plane:
            rays(settings.calibration.camera)  # half a second that must not be spent after the last frame

    def close(self) -> None:
        """Close the scan file; idempotent."""
        if self._frames is not None:
            self._frames.close()
            self._frames = None

    # ---- what comes in ----

    def take_image(self, image: Image, payload: memoryview) -> bool:
        """Fold a live frame if it is whole and its turn has come; True if the fold went on."""
        if not self.check.is_of_this_sweep(image):
            return False
        self._newest_live = max(self._newest_live, image.frame_index)
        if not self.cursor.wants(image.frame_index):
            return False
        pixels = self.check.pixels(image, payload)
        if pixels is None:
            return False
        self._position_um[image.frame_index] = image.position_um
        with self.timings.stage("fold_live"):
            return self._offer(image.frame_index, image.crc32, demosaiced(pixels, self.form.pixel_format))

    def take_end(self, end: End) -> None:
        """The end message of the rig."""
        self.end, self.ended = ScanEnd.of_message(end), end.outcome in SEALED_OUTCOMES

    def take_status(self, status: Status) -> None:
        """The end of the scan as the status has it, if its message was lost on the live lane."""
        if self.ended or status.scan_uid != self.description.scan_uid:
            return
        if status.outcome not in SEALED_OUTCOMES:
            self._status_is_old = False
        elif not self._status_is_old:
            self.end, self.ended = ScanEnd(status.outcome), True

    def _offer(self, frame_index: int, crc32: int, pixels: NDArray[np.generic]) -> bool:
        try:
            went_on = self.cursor.offer(frame_index, crc32, pixels)
        except Exception:  # noqa: BLE001 - a frame that breaks the fold costs a new fold of the file, not the scan (F08)
            logger.exception("frame %d could not be folded: folding the scan file again", frame_index)
            self.check.refused.raised += 1
            self.restart()
            return False
        if went_on:
            self._last_frame_ns = self._clock.now_ns()
        return went_on

    def restart(self) -> None:
        """Forget what was folded; the frames are read from the file again."""
        self.cursor.restart()
        self._early = EarlyFits(self.settings, self.form)

    # ---- the file ----

    @property
    def lag_frames(self) -> int:
        """Frames taken and not folded yet, by the newest live frame; after the end, by the plan."""
        taken = self.description.count if self.ended else self._newest_live + 1
        return max(taken - self.cursor.next_index, 0)

    @property
    def wants_file(self) -> bool:
        """True if the file should be read: frames are known to be there, or no live frame came for a while."""
        if self.lag_frames:
            return True
        return self._clock.now_ns() - self._last_frame_ns > SILENT_NS and not self.cursor.done

    def frames(self) -> ScanFrames | None:
        """The scan file; None while the writer has not made it."""
        if self._frames is None:
            self._frames = open_frames(self.description.folder, self.description.scan_uid)
        waits = self.description.reopened and not self.ended
        if waits and self._frames is not None and self._frames.layout.path.name != PARTIAL_NAME:
            self.close()  # the writer has not reopened it yet: the file still says that no frame will follow
        return self._frames

    def catch_up(self) -> None:
        """Take the frames that are in the file already from there (after a late start)."""
        frames = self.frames()
        if frames is not None:
            self._newest_live = max(self._newest_live, int(frames.present().sum()) - 1)

    def fill(self) -> int:
        """Fold a few frames from the file where the live lane left a gap; returns how many were read."""
        frames = self.frames()
        if frames is None or self.cursor.done or not (self.lag_frames or self._overdue(frames)):
            return 0
        before, count = self.cursor.next_index, self.description.count
        with self.timings.stage("fold_file"):
            # not beyond the newest live frame: those that follow it are on their way
            through = count if self.ended else max(self._newest_live, before)
            never = self.end.never_coming(count, frames.outcome)
            limit = max(1, FILE_BYTES_AT_ONCE // self.form.nbytes)
            read = self.cursor.fill(frames, limit=limit, through=through, never=never)
        if read:
            self._last_frame_ns = self._clock.now_ns()
            filled = slice(before, self.cursor.next_index)
            known = frames.present()[filled]
            self._position_um[filled][known] = frames.field("position_um")[filled][known]
        return read

    def _overdue(self, frames: ScanFrames) -> bool:
        """True if the next frame has been in the file for so long that the live lane must have lost it."""
        frame_index, now_ns = self.cursor.next_index, self._clock.now_ns()
        if not frames.present()[frame_index]:
            return False
        if self._seen_in_file[0] != frame_index:
            self._seen_in_file = (frame_index, now_ns)
        return now_ns - self._seen_in_file[1] >= SILENT_NS

    # ---- what goes out while the sweep runs ----

    def preview(self) -> ProvisionalCloud | None:
        """Points and maps now; None before the first frame."""
        if not self.cursor.folded.any():
            return None
        found = provisional_cloud(self.cursor, self.settings, self._position_um)
        self._counts = found.counts
        frames = self.frames()
        if frames is not None:
            self._early.propose(found.maps, self.cursor.fold.present, frames)
        return found

    def progress(self) -> ResultProgress:
        """How far the fold is."""
        counts = self.cursor.counts
        return ResultProgress(
            scan_uid=self.description.scan_uid,
            version=0,
            folded_through=self.cursor.fold.folded_through,
            expected=self.description.count,
            over_contrast=self._counts.over_contrast,
            points_settled=self._counts.settled,
            points_provisional=self._counts.provisional,
            from_live=counts.from_live,
            from_file=counts.from_file,
            refolded=counts.refolded,
            lag_frames=self.lag_frames,
            message=self._message(),
            failed=bool(self.failure),
        )

    def _message(self) -> str:
        if self.failure:
            return self.failure
        if self.lag_frames and self.frames() is None:
            return "waiting for the writer to make the scan file"
        if self.lag_frames:
            return f"reading frame {self.cursor.next_index} from the scan file"
        return "; ".join([*self.settings.warnings, *filter(None, [self.settings.what_is_missing])])

    @property
    def may_fit_early(self) -> bool:
        """Estimates can be made now that are then not left to the end."""
        return self._early.busy

    def fit_early(self) -> None:
        """Make a few of them: some milliseconds."""
        with self.timings.stage("estimate_early"):
            self._early.work()

    # ---- the end ----

    def ready_to_finish(self) -> bool:
        """True if every frame is folded or known to be missing, and those folded are in the file."""
        if self.results is not None or self.failure or not self.cursor.done:
            return False
        frames = self.frames()
        return frames is not None and (self.ended or bool(frames.present().all()))

    def finish(self) -> Results:
        """Compare the fold with the file, fold again what differs, and write the results beside the scan file.

        A worker that was started after the scan finds results there already; it leaves them alone.

        Raises:
            ScanFileError, CalibrationError, ResultWriteError: as ``write_results``.
        """
        frames = self.frames()
        assert frames is not None
        found = results_on_disk(self.cursor, frames, self.settings) if self.cursor.counts.from_live == 0 else None
        self._left_alone = found is not None
        if found is None:
            self._match(frames)
            found = write_results(
                self.cursor,
                frames,
                self.settings,
                frames.layout.path.parent,
                outcome=self.end.outcome,
                checks=self.end.checks,
                timings=self.timings,
                compare=False,
                more_counts=self.check.refused.report_counts(),
                early=self._early.estimates,
            )
        self.results = found
        self.seconds_to_disk = self.seconds_to_disk or (self._clock.now_ns() - self._last_frame_ns) / NS_PER_S
        self._counts = PointCounts(found.report.counts["over_contrast"], len(found.cloud or ()), 0)
        return found

    def _match(self, frames: ScanFrames) -> None:
        """Fold the file anew if a frame differs from what was folded."""
        with self.timings.stage("compare"):
            different = self.cursor.differs_from(frames)
        if not different:
            return
        logger.warning("%d frames differ from the scan file (first: %d): folding anew", len(different), different[0])
        self.restart()
        count = self.description.count
        with self.timings.stage("refold"):
            self.cursor.fill(frames, limit=count, never=np.ones(count, np.bool_))

    def refresh(self) -> bool:
        """Bring a finished report up to date: outcome, digest and truth may be known only later; True if it changed.

        Raises:
            ResultWriteError: the folder cannot be written to.
        """
        frames = self.frames()
        if self.results is None or frames is None or self._left_alone:
            return False
        if self.ended and self.cursor.differs_from(frames):
            self.results = None  # a frame was committed again after the results: finish once more
            return False
        report = refresh_report(self.results, frames, self.settings, self.end.outcome, self.end.checks)
        if report == self.results.report:
            return False
        self.results = dataclasses.replace(self.results, report=report)
        return True

    def end_message(self) -> ResultEnd | None:
        """Where the results are; None before they are written and the end of the scan is known."""
        results = self.results
        if results is None or not self.ended:
            return None
        return ResultEnd(
            scan_uid=self.description.scan_uid,
            version=0,
            outcome=self.end.outcome,
            folded_through=self.cursor.fold.folded_through,
            points=results.report.counts["points"],
            maps_path=str(results.paths.maps),
            cloud_path=str(results.paths.cloud) if results.cloud is not None else "",
            report_path=str(results.paths.report),
            seconds=self.seconds_to_disk,
            message=self.settings.what_is_missing,
        )
