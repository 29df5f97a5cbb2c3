"""Reconstruct a scan file, partial or sealed: the same maps and cloud as the live worker makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquire.contract.errors import ConfigError
from acquire.contract.states import outcome_words

from .final_maps import new_fold
from .fold_cursor import FoldCursor
from .scan_frames import ScanFrames
from .settings import ReconstructOptions, recorded_in, settle
from .timings import Timings
from .write import ResultPaths, Results, write_results

Progress = Callable[[int, int], None]
"""Called with (frames done, frames of the plan)."""

_AT_ONCE = 16


@dataclass(frozen=True)
class Summary:
    """The outcome of :func:`reconstruct`, for the command line."""

    scan: Path
    paths: ResultPaths
    complete: bool
    """False: frames are missing (exit status 4)."""
    outcome: str
    outcome_text: str
    points: int | None
    """None: no cloud was made; the warnings say why."""
    results: Results

    @property
    def warnings(self) -> list[str]:
        """What the user should know."""
        return self.results.report.warnings


def reconstruct(scan: Path, options: ReconstructOptions, progress: Progress | None = None) -> Summary:
    """Fold SCAN (a folder or its .h5) and write maps.h5, cloud.ply, report.json beside it or into ``options.out``.

    Missing and damaged frames are skipped. Without a calibration there are maps and no cloud.

    Raises:
        ScanFileError: no readable scan, or no usable frame in it.
        CalibrationError, ConfigError: as :func:`settings.settle`.
        ResultWriteError: the results cannot be written.
    """
    timings = Timings()
    with ScanFrames(scan) as frames, timings.stage("total"):
        layout = frames.layout
        settings = settle(recorded_in(layout), options)
        folder = _folder(options.out, layout.path)
        cursor = FoldCursor(lambda: new_fold(settings, layout.format, layout.count), layout.count, 0)
        never = np.ones(layout.count, np.bool_)
        with timings.stage("fold"):
            while not cursor.done:
                cursor.fill(frames, limit=_AT_ONCE, never=never)
                if progress is not None:
                    progress(cursor.next_index, cursor.count)
        outcome = frames.outcome
        results = write_results(cursor, frames, settings, folder, outcome=outcome, timings=timings)
    committed = results.report.counts["committed"] - len(frames.damaged)
    return Summary(
        scan=layout.path,
        paths=results.paths,
        complete=committed == layout.count,
        outcome=outcome,
        outcome_text=outcome_words(outcome, committed, layout.count),
        points=None if results.cloud is None else len(results.cloud),
        results=results,
    )


def _folder(out: Path | None, scan_file: Path) -> Path:
    if out is None:
        return scan_file.parent
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot create the folder {out}: {error.strerror}; name another with --out") from None
    return out
