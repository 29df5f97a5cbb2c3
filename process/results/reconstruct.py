"""Reconstruct a scan file, partial or sealed: the same maps and cloud as the live worker makes of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from acquire.contract.errors import ConfigError
from acquire.contract.states import outcome_words

from .final_maps import maps_of, new_fold
from .fold_cursor import FoldCursor
from .nothing_found import other_edge
from .scan_frames import ScanFrames
from .settings import ReconstructOptions, Settings, recorded_in, settle
from .timings import Timings
from .write import ResultPaths, Results, write_results

Progress = Callable[[int, int], None]
"""Called with (frames done, frames of the plan)."""

_AT_ONCE = 16
NEARLY_ALL = 0.9
"""Share of the pixels over the contrast that begin beyond half brightness, from which on the other edge is taken."""


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
    def nothing(self) -> str:
        """Why there is no point (without a light plane: no crossing), and what to try; empty where there is one."""
        return self.results.nothing

    @property
    def warnings(self) -> list[str]:
        """What the user should know."""
        return self.results.report.warnings

    @property
    def notes(self) -> list[str]:
        """What is no fault, but worth knowing."""
        return self.results.report.notes


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
        with timings.stage("fold"):
            cursor = _folded(frames, settings, progress)
            if not settings.edge_is_known:
                settings, cursor = _by_the_right_edge(frames, settings, cursor, progress)
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


def _folded(frames: ScanFrames, settings: Settings, progress: Progress | None) -> FoldCursor:
    layout = frames.layout
    cursor = FoldCursor(lambda: new_fold(settings, layout.format, layout.count), layout.count, 0)
    never = np.ones(layout.count, np.bool_)
    while not cursor.done:
        cursor.fill(frames, limit=_AT_ONCE, never=never)
        if progress is not None:
            progress(cursor.next_index, cursor.count)
    return cursor


def _by_the_right_edge(
    frames: ScanFrames, settings: Settings, cursor: FoldCursor, progress: Progress | None
) -> tuple[Settings, FoldCursor]:
    """The fold by the other edge where hardly any pixel has one of the default, because all begin beyond it."""
    if not cursor.folded.any():
        return settings, cursor
    counts = maps_of(cursor.fold, settings).counts
    if counts["past_s_in_first"] <= NEARLY_ALL * counts["over_contrast"]:
        return settings, cursor
    edge = other_edge(settings.edge)
    note = (
        f"{counts['past_s_in_first']} of {counts['over_contrast']} pixels begin beyond half brightness: the edge is "
        f"taken for a {edge} one (--edge {settings.edge} insists)"
    )
    settings = replace(settings, edge=edge, warnings=(*settings.warnings, note))
    return settings, _folded(frames, settings, progress)


def _folder(out: Path | None, scan_file: Path) -> Path:
    if out is None:
        return scan_file.parent
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"cannot create the folder {out}: {error.strerror}; name another with --out") from None
    return out
