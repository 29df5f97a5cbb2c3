"""From a scan, a camera and the file of reference planes to the light planes: all steps in order."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from acquire.contract.calibration import PerFramePlanes, check_size, load_calibration
from acquire.contract.errors import CalibrationError
from process.calibration.calibration_file import read_document
from process.calibration.light_plane.sweeps import fold_sweep
from process.calibration.light_plane.uncertainty import camera_covariance
from process.cloud.light_planes import planes_at
from process.results.scan_frames import ScanFrames

from .calibrate import Edges, check_planes, find_edges, fit_reference_planes
from .known_planes import plane_from_markers, read_marked
from .result import ReferenceResult
from .sweep_pictures import PASSES, Progress, read_sweep
from .uncertainty import spread_of


def calibrate_sweep(
    scan: Path,
    camera_file: Path,
    planes_file: Path,
    *,
    method: str,
    edge: Literal["rising", "falling"],
    contrast: int,
    progress: Progress | None = None,
) -> tuple[ReferenceResult, Edges]:
    """The light planes of a sweep, and the edges that they are made of.

    Args:
        scan: folder or .h5.
        camera_file: calibration with the camera.
        planes_file: see ``known_planes``.
        method: the crossing estimate that points will be made with.
        edge: falling for the front of a shadow, rising for its end or for light.
        contrast: least brightness range of a pixel, counts of 8 bit.
        progress: of reading the pictures.

    Raises:
        CalibrationError, ScanFileError: what is wrong with which of the files.
    """
    camera = load_calibration(camera_file)[0]
    with ScanFrames(scan) as frames:
        check_size(camera, frames.layout.format.width, frames.layout.format.height)
    marked = read_marked(planes_file, camera.camera.width, camera.camera.height)
    known = [plane_from_markers(one, camera.camera) for one in marked]
    check_planes(known)
    covariance = camera_covariance(read_document(camera_file))
    folded = fold_sweep(scan, method=method, edge=edge, contrast=contrast, clean=False)
    sweep = read_sweep(scan, known, edge=edge, contrast=contrast, progress=progress)
    for region in sweep.regions:
        if not region.motion.any():
            raise CalibrationError(
                f"no edge passes the region of {region.plane.name} with a contrast of {contrast}: is image_region_px "
                "right, and is the light in it? --contrast takes darker pictures"
            )
    last = None if progress is None else _last_pass(progress)
    local = method in ("auto", "fit")
    edges = find_edges(sweep, folded.crossing, camera.camera, edge=edge, local_levels=local, progress=last)
    result = fit_reference_planes(edges, known, camera.camera, frames=sweep.frames, edge=edge, method=method)
    result = replace(result, spread=spread_of(edges, marked, camera.camera, covariance, result))
    return _counted(result, folded.crossing), edges


def _last_pass(progress: Progress) -> Progress:
    return lambda read, of: progress((PASSES - 1) * of + read, PASSES * of)


def _counted(result: ReferenceResult, crossing: Any) -> ReferenceResult:
    """The result, with the crossings that no plane belongs to."""
    t = crossing[np.isfinite(crossing)] + 1
    document = result.document()
    rows = tuple(None if row is None else tuple(row) for row in document["planes"])
    planes = PerFramePlanes("frame", document["first_frame"], rows)
    lost = int(np.isnan(planes_at(planes, t)[:, 0]).sum()) if len(t) else 0
    return replace(result, crossings=len(t), without_plane=lost)
