"""Owns what a worker does ahead of a scan's end: estimates of pixels whose edge has passed, from frames in the file.

Promises the same results without it: whatever goes wrong here is left to the end.
"""

from __future__ import annotations

import logging

import numpy as np

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from process.crossings.maps import Maps
from process.edge_fit.early_estimates import EarlyEstimates
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.refine import starts
from process.edge_fit.weighting import FrameSequence
from process.fold.fold import Fold
from process.results.final_maps import sequence_of
from process.results.fold_cursor import FoldCursor
from process.results.scan_frames import ScanFrames
from process.results.settings import Settings

logger = logging.getLogger(__name__)


class Ahead:
    """The early estimates of one scan, for the fold that is its cursor's now."""

    def __init__(self, settings: Settings, form: FrameFormat) -> None:
        self._settings = settings
        self._form = form
        self._wanted = settings.method in ("fit", "auto")
        self._fold: Fold | None = None
        self._early: EarlyEstimates | None = None
        self._sequence: FrameSequence | None = None
        self._looked = False

    def propose(self, maps: Maps, cursor: FoldCursor, frames: ScanFrames | None) -> None:
        """There are new maps of the fold, and perhaps more frames in the file."""
        if not self._wanted or frames is None:
            return
        present = cursor.fold.present
        there = frames.usable()[present]
        present = present if there.all() else present[: int(np.argmin(there))]
        try:
            self._sequence = sequence_of(frames, present, self._settings)
        except ScanFileError as error:
            self._give_up(error)
            return
        if self._early is None or self._fold is not cursor.fold:
            self._fold, self._early = cursor.fold, self._new()
        self._looked = False
        if self._early.weighting_finder.weighting is not None:
            self._early.propose(maps, starts(maps, cursor.fold.present), len(present))

    def _give_up(self, error: ScanFileError) -> None:
        logger.warning("no estimates ahead of the end: %s", error)
        self._wanted, self._sequence, self._early = False, None, None

    def _new(self) -> EarlyEstimates:
        levels = self._settings.noise_counts * 2.0 ** (self._form.bit_depth - 8)
        shape = (self._form.height, self._form.width)
        return EarlyEstimates(shape, assumed_noise(levels), local=self._settings.method == "auto")

    @property
    def busy(self) -> bool:
        """There is something to do before the next maps."""
        if self._early is None or self._sequence is None:
            return False
        return self._early.busy or not self._looked

    def work(self, cursor: FoldCursor) -> None:
        """Do some of it."""
        if self._early is None or self._sequence is None or self._fold is not cursor.fold:
            self._sequence = None
            return
        try:
            if self._early.busy:
                self._early.work(self._sequence)
            else:
                self._looked = not self._early.weighting_finder.advance(self._sequence, 1)
        except ScanFileError as error:
            self._give_up(error)

    def estimates(self, cursor: FoldCursor) -> EarlyEstimates | None:
        """Those of the cursor's fold; None if there are none."""
        return self._early if self._fold is cursor.fold else None
