"""Owns what a folded scan leaves on disk: maps.h5, cloud.ply, report.json; worker and reconstruct share it."""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.dataset_names import CLOUD_NAME, MAPS_NAME, REPORT_NAME, TRUTH_NAME, FrameStatus
from acquire.contract.states import SEALED_OUTCOMES
from process.cloud.cloud import Cloud, make_cloud, write_ply
from process.cloud.triangulation import coordinates, plane_table, rays
from process.crossings.light_change import light_counts, light_warnings, marked
from process.crossings.maps import Maps, full_scale
from process.crossings.quality import Quality
from process.edge_fit.early_estimates import EarlyEstimates
from process.edge_fit.filters import filtered
from process.edge_fit.noise_model import assumed_noise
from process.edge_fit.refine import Refined, refine
from process.edge_fit.weighting import Sequence
from process.fold.fold import Fold

from .fold_cursor import CursorCounts, FoldCursor
from .maps_file import MapsSource, read_source, write_maps
from .report import (
    Report,
    SweepChecks,
    checks_of,
    contrast_histogram,
    read_report,
    sweep_speed,
    truth_errors,
    versions,
    write_report,
)
from .report_findings import NoiseFound, age_warning, calibration_used, damage, no_cloud, noise_found, quality_warnings
from .scan_frames import ScanFrames
from .settings import Settings
from .timings import Timings

logger = logging.getLogger(__name__)

_BITS = {name: f"quality_{name}" for name in (str(bit.name).lower() for bit in Quality)}
"""The fold's names of pixels by quality bit -> those in the report, where ``from_file`` already means frames."""


NOT_MEASURED = SweepChecks()


@dataclass(frozen=True)
class ResultPaths:
    """Where the results of a scan stand."""

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
    cloud: Cloud | None
    """None without a light plane."""
    report: Report


def new_fold(settings: Settings, frames: Any, count: int) -> Fold:
    """An empty fold for frames of this ``FrameFormat``."""
    return Fold(
        (frames.height, frames.width), bit_depth=frames.bit_depth, edge=settings.edge, frames_expected=max(count, 1)
    )


def cloud_of(
    maps: Maps, settings: Settings, folded: NDArray[np.bool_], position_um: NDArray[np.float64]
) -> Cloud | None:
    """The default cloud of some maps; None without a light plane.

    Raises:
        CalibrationError: the plane counts in um and the scan does not know its positions.
    """
    plane = settings.light_plane
    if settings.calibration is None or plane is None:
        return None
    frame_t = coordinates(plane, len(folded), folded, position_um)
    return make_cloud(maps, rays(settings.calibration.camera), plane_table(plane), frame_t)


def write_results(
    cursor: FoldCursor,
    frames: ScanFrames,
    settings: Settings,
    folder: Path,
    *,
    outcome: str,
    timings: Timings,
    checks: SweepChecks = NOT_MEASURED,
    compare: bool = True,
    more_counts: dict[str, int] | None = None,
    early: EarlyEstimates | None = None,
) -> Results:
    """Turn a finished fold into files; each replaces its predecessor by a rename.

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
        maps = refined.maps
    with timings.stage("cloud"):
        cloud = cloud_of(maps, settings, cursor.folded, frames.positions_um())
    digest = frames.digest()
    source = MapsSource(frames.layout.scan_uid, digest, cursor.fold.folded_through)
    with timings.stage("write_cloud"):
        if cloud is not None:
            write_ply(paths.cloud, cloud)
    with timings.stage("write_maps"):
        write_maps(paths.maps, maps, settings, source)
    with timings.stage("report"):
        other = frames.other_light()
        noise = _noise(refined, settings, frames)
        calibration = calibration_used(settings, frames.layout.start_time)
        report = Report(
            counts=counts(frames.status(), cursor.counts, maps.counts, cloud)
            | light_counts(other)
            | (more_counts or {}),
            timings_s={},
            contrast_histogram=contrast_histogram(maps.minimum, maps.maximum, frames.layout.format.bit_depth),
            speed=sweep_speed(frames.layout.plan, settings.light_plane),
            outcome=outcome,
            digest=digest,
            sweep=checks if checks != NOT_MEASURED else _earlier_checks(frames, digest),
            warnings=[
                *settings.warnings,
                *damage(frames.damaged),
                *no_cloud(settings, cloud is not None, paths.cloud),
                *age_warning(settings, calibration),
                *quality_warnings(maps.counts, noise, shadow=settings.edge == "falling"),
                *light_warnings(other, maps.counts),
            ],
            settings=_settings(settings),
            versions=versions(frames.layout.program_version),
            truth=_truth(frames, cloud, settings) if compare else None,
            noise=noise,
            calibration=calibration,
        )
    clock_s, processor_s = timings.rounded()
    report = msgspec.structs.replace(report, timings_s=clock_s, processor_s=processor_s)
    write_report(paths.report, report)
    return Results(paths, cloud, report)


def sequence_of(frames: ScanFrames, present: NDArray[np.int64], settings: Settings) -> Sequence:
    """The folded frames of a scan file as the estimates see them."""
    return Sequence(frames.columns_of(present), present, settings.edge, frames.layout.format.bit_depth)


def final_maps(
    cursor: FoldCursor, frames: ScanFrames, settings: Settings, early: EarlyEstimates | None = None
) -> Refined:
    """The maps of all frames folded, by the method of the settings; what the fold does not know is in the file.

    early: estimates of the same frames that were made while they came; they change nothing but the time this takes.

    Raises:
        ScanFileError: nothing was folded, or the file contradicts what was.
    """
    if not cursor.folded.any():
        raise ScanFileError(f"{frames.layout.path} holds no frame that can be used: there is nothing to reconstruct")
    present = cursor.fold.present
    maps = cursor.fold.result(
        contrast=settings.contrast,
        median=settings.median,
        method=settings.live_method,
        noise_counts=settings.noise_counts,
        read_columns=lambda pixels: (present, frames.columns(present, pixels)),
    )
    sequence = sequence_of(frames, present, settings)
    if settings.method == "linear":  # the paper's estimate, as it is: neither filtered nor weighed
        maps = marked(maps, frames.other_light())
        return Refined(maps, assumed_noise(settings.noise_counts), np.full(maps.mask.shape, np.nan, np.float32))
    refined = refine(maps, settings.method, sequence, settings.noise_counts, early)
    return dataclasses.replace(refined, maps=marked(filtered(refined.maps), frames.other_light()))


def _noise(refined: Refined, settings: Settings, frames: ScanFrames) -> NoiseFound | None:
    if settings.method == "linear":
        return None
    full = full_scale(frames.layout.format.bit_depth) if settings.edge == "falling" else 0
    return noise_found(refined.noise, full)


def results_on_disk(cursor: FoldCursor, frames: ScanFrames, settings: Settings) -> Results | None:
    """The results that stand beside the scan file already, with the cloud made anew; None if they are not of it."""
    paths = ResultPaths(frames.layout.path.parent)
    try:
        source, report = read_source(paths.maps), read_report(paths.report)
    except ScanFileError:
        return None
    of_this = (source.scan_uid, source.digest, report.outcome) == (
        frames.layout.scan_uid,
        frames.digest(),
        frames.outcome,
    )
    if not of_this or frames.outcome not in SEALED_OUTCOMES:
        return None
    maps = final_maps(cursor, frames, settings).maps
    return Results(paths, cloud_of(maps, settings, cursor.folded, frames.positions_um()), report)


def refresh_report(
    results: Results, frames: ScanFrames, settings: Settings, outcome: str, checks: SweepChecks
) -> Report:
    """Write the report again with what became known since: how the scan ended, its digest, the truth.

    Raises:
        ResultWriteError: the folder cannot be written to.
    """
    old = results.report
    known = counts(frames.status(), CursorCounts(), {}, results.cloud)
    report = msgspec.structs.replace(
        old,
        counts=old.counts | {key: known[key] for key in ("committed", "missing", "retaken")},
        outcome=outcome,
        digest=frames.digest(),
        sweep=checks if checks != NOT_MEASURED else old.sweep,
        truth=old.truth or _truth(frames, results.cloud, settings),
    )
    if report != old:
        write_report(results.paths.report, report)
    return report


def counts(
    status: NDArray[np.uint8], cursor: CursorCounts, maps: dict[str, int], cloud: Cloud | None
) -> dict[str, int]:
    """The counts of report.json."""
    committed = int(np.isin(status, (FrameStatus.GOOD, FrameStatus.RETAKEN)).sum())
    return {
        "frames": len(status),
        "committed": committed,
        "missing": len(status) - committed,
        "retaken": int((status == FrameStatus.RETAKEN).sum()),
        "points": 0 if cloud is None else len(cloud),
        "from_live": cursor.from_live,
        "from_file": cursor.from_file,
        "refolded": cursor.refolded,
        **{_BITS.get(key, key): number for key, number in maps.items()},
    }


def _earlier_checks(frames: ScanFrames, digest: str) -> SweepChecks:
    """What the rig measured around this sweep: from the scan; of older scans, from the report that was made then."""
    if found := frames.measured:
        return checks_of(found)
    try:
        report = read_report(ResultPaths(frames.layout.path.parent).report)
    except ScanFileError:
        return NOT_MEASURED
    return report.sweep if report.digest == digest else NOT_MEASURED


def _settings(settings: Settings) -> dict[str, Any]:
    return {
        "contrast": settings.contrast,
        "median": settings.median,
        "edge": settings.edge,
        "method": settings.method,
        "noise_counts": settings.noise_counts,
    }


def _truth(frames: ScanFrames, cloud: Cloud | None, settings: Settings) -> Any:
    path = frames.layout.path.parent / TRUTH_NAME
    if cloud is None or not path.is_file():
        return None
    try:
        return truth_errors(path, cloud, settings.contrast)
    except ScanFileError as error:
        logger.warning("%s", error)  # the simulation may still be writing it
        return None
