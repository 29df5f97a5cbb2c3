"""Reads what a reconstruction left: maps, cloud and report as one value, checked to belong together."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.file_layout import ScanLayout, read_layout
from acquire.contract.scan_data.maps_file import read_maps
from acquire.contract.scan_data.report_file import Report, read_report
from process.cloud.cloud import LEFT_OUT
from process.cloud.ply import read_vertices
from process.results.write import ResultPaths

MAKE_THEM = "make the results again with 'sweepscope reconstruct'"


@dataclass(frozen=True)
class ScanResults:
    """A scan and what was made of it."""

    layout: ScanLayout
    report: Report
    maps: dict[str, NDArray[Any]]
    """min, max, mask, crossing, sigma, quality, colour: [h, w] and [h, w, 3]."""
    cloud: NDArray[Any] | None
    """Records of ``ply.VERTEX``, [n]; None without a cloud."""
    in_cloud: NDArray[np.bool_]
    """[h, w]; its true pixels are the cloud's points in their order, or all false where that is not known."""

    @property
    def sigma_um(self) -> NDArray[np.float64]:
        """[h, w] standard deviation along the ray; NaN without a point."""
        found = np.full(self.in_cloud.shape, np.nan)
        if self.cloud is not None and self.in_cloud.any():
            found[self.in_cloud] = self.cloud["sigma_um"]
        return found


def read_results(scan: Path, folder: Path | None = None) -> ScanResults:
    """The results of SCAN, beside its .h5 or in ``folder``.

    Raises:
        ScanFileError: no readable scan, no results, or those of another scan.
    """
    layout = read_layout(scan)
    paths = ResultPaths(folder or layout.path.parent)
    if not paths.report.is_file() or not paths.maps.is_file():
        raise ScanFileError(f"{paths.folder} holds no results of {layout.path.name}: {MAKE_THEM}")
    found, report = read_maps(paths.maps), read_report(paths.report)
    if found.header.scan_uid != layout.scan_uid:
        raise ScanFileError(f"{paths.maps} was made of another scan: {MAKE_THEM}")
    maps = found.arrays
    cloud = read_vertices(paths.cloud, instead=MAKE_THEM) if report.points else None
    kept = np.isfinite(maps["crossing"]) & ((maps["quality"] & LEFT_OUT) == 0)
    if cloud is None or int(kept.sum()) != len(cloud):
        kept = _those_of(cloud, maps, kept)
    return ScanResults(layout, report, maps, cloud, kept)


def _those_of(cloud: NDArray[Any] | None, maps: dict[str, NDArray[Any]], kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Pixels of a cloud that lacks some of the maps' crossings (no light plane there), found by their crossings."""
    none = np.zeros(kept.shape, np.bool_)
    if cloud is None or not len(cloud):
        return none
    crossing = maps["crossing"][kept].astype(np.float32)
    place, used = 0, np.zeros(crossing.size, np.bool_)
    known = cloud["crossing"]
    for index, value in enumerate(crossing):
        if place < len(known) and value == known[place]:
            used[index], place = True, place + 1
    if place < len(known):
        return none
    none[kept] = used
    return none
