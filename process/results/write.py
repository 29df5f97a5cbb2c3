"""Write the results of a folded scan: maps.h5, cloud.ply, report.json. Worker and reconstruct share it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError, SweepscopeError
from acquire.contract.files import replace_file
from acquire.contract.scan_data.dataset_names import CLOUD_NAME, MAPS_NAME, REPORT_NAME
from acquire.contract.scan_data.maps_file import MAPS, MapsHeader, read_maps, write_maps
from acquire.contract.scan_data.report_file import Report, SweepChecks, read_report, report_bytes
from acquire.contract.states import SEALED_OUTCOMES
from process.cloud.cloud import PointCloud
from process.cloud.ply import write_ply
from process.crossings.maps import Maps
from process.edge_fit.early_estimates import EarlyEstimates

from .final_maps import cloud_of, final_maps
from .fold_cursor import FoldCursor
from .nothing_found import why_nothing
from .report import find_truth, frame_counts, make_report
from .scan_frames import ScanFrames
from .settings import Settings
from .timings import Timings

_MAP_FIELDS = {"min": "minimum", "max": "maximum"}
"""Datasets of maps.h5 whose name differs from the field of ``Maps``."""


class ResultWriteError(SweepscopeError):
    """A result could not be written; what was there before is untouched."""


@dataclass(frozen=True)
class ResultPaths:
    """The files of a scan's results."""

    folder: Path

    @property
    def maps(self) -> Path:
        """maps.h5."""
        return self.folder / MAPS_NAME

    @property
    def cloud(self) -> Path:
        """cloud.ply."""
        return self.folder / CLOUD_NAME

    @property
    def report(self) -> Path:
        """report.json."""
        return self.folder / REPORT_NAME


@dataclass(frozen=True)
class Results:
    """What was written."""

    paths: ResultPaths
    cloud: PointCloud | None
    """None without a light plane."""
    report: Report
    nothing: str = ""
    """Why there is no point (without a light plane: no crossing), and what to try; empty where there is one."""


def write_results(
    cursor: FoldCursor,
    frames: ScanFrames,
    settings: Settings,
    folder: Path,
    *,
    outcome: str,
    timings: Timings,
    checks: SweepChecks | None = None,
    compare: bool = True,
    more_counts: dict[str, int] | None = None,
    early: EarlyEstimates | None = None,
) -> Results:
    """Turn a finished fold into files; each replaces its predecessor in one step.

    ``compare`` False leaves the truth to :func:`refresh_report`, because it takes as long as the maps;
    ``more_counts`` are those that only the caller knows; ``early`` as in :func:`final_maps`.

    Raises:
        ScanFileError: nothing was folded, or the file contradicts what was.
        CalibrationError: as :func:`cloud_of`.
        ResultWriteError: the folder cannot be written to.
    """
    paths = ResultPaths(folder)
    with timings.stage("maps"):
        refined = final_maps(cursor, frames, settings, early)
    with timings.stage("cloud"):
        cloud = cloud_of(refined.maps, settings, cursor.folded, frames.field("position_um"))
    nothing = why_nothing(refined.maps, settings, cloud, frames.layout.format)
    digest = frames.digest()
    with timings.stage("write_cloud"):
        if cloud is not None:
            vertices = cloud.vertices()
            write_result(paths.cloud, lambda path: write_ply(path, vertices))
    with timings.stage("write_maps"):
        arrays = map_arrays(refined.maps)
        header = MapsHeader(
            contrast=settings.contrast,
            median=settings.median,
            edge=settings.edge,
            method=settings.method,
            folded_through=cursor.fold.folded_through,
            source_digest=digest,
            scan_uid=frames.layout.scan_uid,
        )
        write_result(paths.maps, lambda path: write_maps(path, arrays, header))
    with timings.stage("report"):
        report = make_report(
            frames,
            settings,
            cursor.counts,
            refined,
            cloud,
            cloud_path=paths.cloud,
            outcome=outcome,
            digest=digest,
            checks=checks or SweepChecks(),
            more_counts=more_counts or {},
            nothing=nothing,
        )
        truth = find_truth(frames, cloud, settings) if compare else None
    clock_s, processor_s = timings.rounded()
    report = msgspec.structs.replace(report, truth=truth, timings_s=clock_s, processor_s=processor_s)
    write_result(paths.report, report_bytes(report))
    return Results(paths, cloud, report, nothing)


def map_arrays(maps: Maps) -> dict[str, NDArray[Any]]:
    """The datasets of maps.h5."""
    return {name: getattr(maps, _MAP_FIELDS.get(name, name)) for name in MAPS}


def results_on_disk(cursor: FoldCursor, frames: ScanFrames, settings: Settings) -> Results | None:
    """The results that are beside the scan file already, with the cloud made anew; None if they are not of it."""
    paths = ResultPaths(frames.layout.path.parent)
    try:
        header, report = read_maps(paths.maps, ()).header, read_report(paths.report)
    except ScanFileError:
        return None
    made_of = (header.scan_uid, header.source_digest, report.outcome)
    if made_of != (frames.layout.scan_uid, frames.digest(), frames.outcome) or frames.outcome not in SEALED_OUTCOMES:
        return None
    maps = final_maps(cursor, frames, settings).maps
    return Results(paths, cloud_of(maps, settings, cursor.folded, frames.field("position_um")), report)


def refresh_report(
    results: Results, frames: ScanFrames, settings: Settings, outcome: str, checks: SweepChecks
) -> Report:
    """Write the report again with what became known since: how the scan ended, its digest, the truth.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    old = results.report
    report = msgspec.structs.replace(
        old,
        counts=old.counts | frame_counts(frames),
        outcome=outcome,
        digest=frames.digest(),
        sweep=checks if checks != SweepChecks() else old.sweep,
        truth=old.truth or find_truth(frames, results.cloud, settings),
    )
    if report != old:
        write_result(results.paths.report, report_bytes(report))
    return report


def write_result(path: Path, content: bytes | Callable[[Path], object]) -> None:
    """Replace a result; it is not synced to disk, because it can be made again from the scan.

    Raises:
        ResultWriteError: the folder is missing, full or not writable.
    """
    try:
        replace_file(path, content)
    except OSError as error:
        why = error.strerror or str(error).splitlines()[0]
        raise ResultWriteError(
            f"cannot write {path}: {why}; the scan is safe, make room or choose another folder with --out"
        ) from None
