"""The folder of scans as the page lists it: which have a cloud, what is known of them, their points. Reads only."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ScanFileError
from acquire.contract.scan_data.dataset_names import CLOUD_NAME
from acquire.contract.scan_data.report_file import find_report
from process.cloud.ply import VERTEX, read_vertices
from process.viewer.rig_client.tile import Tile

MOST_LISTED = 200
MAX_POINTS = 40_000_000
TILE_POINTS = 6_000
"""Points of one tile of an opened scan, about."""


@dataclass(frozen=True)
class ListedScan:
    """One scan with a cloud."""

    folder: Path
    name: str
    """The folder's name: stamp and name."""
    outcome: str
    """As the report has it; empty without a report."""
    points: int | None
    """None without a report."""

    @property
    def label(self) -> str:
        """For a list."""
        points = f", {self.points:,} points" if self.points is not None else ""
        return f"{self.name} ({self.outcome or 'no report'}{points})"


@dataclass(frozen=True)
class OpenedScan:
    """A scan that is shown instead of the rig's."""

    entry: ListedScan
    tiles: dict[int, Tile]


def list_scans(data_dir: Path) -> list[ListedScan]:
    """Scans that have a cloud, newest first; what cannot be read is left out."""
    try:
        folders = sorted((path for path in data_dir.iterdir() if path.is_dir()), key=lambda path: path.name)
        with_cloud = [path for path in folders if (path / CLOUD_NAME).is_file()]
    except OSError:
        return []
    return [_entry(folder) for folder in reversed(with_cloud[-MOST_LISTED:])]


def _entry(folder: Path) -> ListedScan:
    report = find_report(folder)
    return ListedScan(folder, folder.name, report.outcome if report else "", report.points if report else None)


def facts_of(folder: Path | None) -> list[tuple[str, str]]:
    """Outcome, numbers and settings of a scan by name, as its report has them."""
    report = find_report(folder) if folder is not None else None
    if report is None:
        return [("Outcome", "still running")]
    facts = [("Outcome", report.outcome or "still running")]
    values, names = report.counts | report.settings, ("frames", "missing", "points", "method", "contrast", "edge")
    facts += [(name.capitalize(), str(values[name])) for name in names if name in values]
    return [*facts, ("Digest", report.digest[:16])] if report.digest else facts


def open_scan(entry: ListedScan) -> OpenedScan:
    """Read a scan to show it.

    Raises:
        ScanFileError: as :func:`read_tiles`.
    """
    return OpenedScan(entry, read_tiles(entry.folder))


def read_tiles(folder: Path) -> dict[int, Tile]:
    """The cloud of a scan, grouped by where the points are, seen from above.

    Raises:
        ScanFileError: there is none, or it is not one of ours.
    """
    path = folder / CLOUD_NAME
    vertices = read_vertices(path, instead="'sweepscope reconstruct' makes it anew")
    missing = [name for name in VERTEX.names or () if name not in (vertices.dtype.names or ())]
    if missing:
        raise ScanFileError(f"{path} has no {', '.join(missing)}: it is not one of our clouds")
    if len(vertices) > MAX_POINTS:
        raise ScanFileError(f"{path} has {len(vertices):,} points; the page shows up to {MAX_POINTS:,}")
    return _tiles(vertices)


def _tiles(vertices: NDArray[np.void]) -> dict[int, Tile]:
    """Points grouped by where they are, seen from above."""
    xyz = np.stack([vertices[axis] for axis in "xyz"], axis=1).astype(np.float64)
    finite = np.isfinite(xyz).all(axis=1)
    vertices, xyz = vertices[finite], xyz[finite]
    if not len(xyz):
        return {}
    cells = max(1, round((len(xyz) / TILE_POINTS) ** 0.5))
    low, span = xyz[:, :2].min(axis=0), np.maximum(np.ptp(xyz[:, :2], axis=0), 1e-9)
    cell = np.minimum(((xyz[:, :2] - low) / span * cells).astype(np.intp), cells - 1)
    key = cell[:, 1] * cells + cell[:, 0]
    order = np.argsort(key, kind="stable")
    numbers, starts = np.unique(key[order], return_index=True)
    parts = np.split(order, starts[1:])
    return {int(number): _tile(vertices[part], xyz[part]) for number, part in zip(numbers, parts, strict=True)}


def _tile(vertices: NDArray[np.void], xyz: NDArray[np.float64]) -> Tile:
    origin = xyz.mean(axis=0)
    return Tile(
        (float(origin[0]), float(origin[1]), float(origin[2])),
        (xyz - origin).astype(np.float32),
        np.stack([vertices[channel] for channel in ("red", "green", "blue")], axis=1),
        np.zeros(len(vertices), np.bool_),
        vertices["crossing"].astype(np.float32),
        vertices["sigma_um"].astype(np.float32),
        vertices["quality"].astype(np.uint16),
    )
