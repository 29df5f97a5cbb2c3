"""Estimates made while the sweep runs, of pixels whose edge has passed, from frames that are in the file already.

The results are the same without them, only later: when anything goes wrong here, all estimates are made at the end.
"""

from __future__ import annotations

import logging

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from process.crossings.maps import Maps
from process.edge_fit.early_estimates import EarlyEstimates
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.refine import starts
from process.edge_fit.weighting import FrameSequence
from process.results.final_maps import sequence_of
from process.results.scan_frames import ScanFrames
from process.results.settings import Settings

logger = logging.getLogger(__name__)


class EarlyFits:
    """The early estimates of one fold; a fold that starts again needs new ones."""

    def __init__(self, settings: Settings, form: FrameFormat) -> None:
        self._settings = settings
        self.estimates: EarlyEstimates | None = None
        """None where the method of the settings fits nothing, and after a failure."""
        if settings.method in ("fit", "auto"):
            noise = assumed_noise(settings.noise_counts * 2.0 ** (form.bit_depth - 8))
            self.estimates = EarlyEstimates((form.height, form.width), noise, local=settings.method == "auto")
        self._sequence: FrameSequence | None = None
        self._weighting_advances = False

    def propose(self, maps: Maps, folded: NDArray[np.int64], frames: ScanFrames) -> None:
        """Look for work in new maps of the fold; ``folded``: indices of the frames that the maps were made of."""
        if self.estimates is None:
            return
        committed = frames.present()[folded]
        count = len(folded) if committed.all() else int(np.argmin(committed))
        try:
            self._sequence = sequence_of(frames, folded[:count], self._settings)
        except ScanFileError as error:
            self._give_up(error)
            return
        self._weighting_advances = True
        if self.estimates.weighting_finder.weighting is not None:
            self.estimates.propose(maps, starts(maps, folded), count)

    @property
    def busy(self) -> bool:
        """True if there is something to do before the next maps."""
        if self.estimates is None or self._sequence is None:
            return False
        return self.estimates.busy or self._weighting_advances

    def work(self) -> None:
        """Do some of it: a few milliseconds."""
        if self.estimates is None or self._sequence is None:
            return
        try:
            if self.estimates.busy:
                self.estimates.work(self._sequence)
            else:
                self._weighting_advances = self.estimates.weighting_finder.advance(self._sequence, 1)
        except ScanFileError as error:
            self._give_up(error)

    def _give_up(self, error: ScanFileError) -> None:
        logger.warning("no estimates before the end of the sweep: %s", error)
        self.estimates = self._sequence = None
