"""Owns choices that the data make: how many distortion terms, which corner estimate, which views are left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .boards import Sighting
from .bundle import MODELS, Fit, fit_camera, thinned
from .poses import find_pose

MOST_FOLDS = 10
HELD_OUT_CORNERS = 300
WORTHWHILE = 0.002
"""A model with more terms has to lower the held-out error by this share."""
HARMFUL = 3.0
"""A view whose residual is so many times the median of the others does not show the same board."""
HARMFUL_FLOOR_PX = 0.05
MIN_VIEWS = 3


def choose_model(
    views: Sequence[Sighting], size: tuple[int, int], start: Fit | None = None
) -> tuple[Fit, dict[str, float]]:
    """The fit with the distortion model that predicts views it has not seen best, and each model's held-out RMS in px.

    A model with more terms is taken only if it predicts clearly better.
    """
    first = fit_camera(views, size, "k1", start)
    fits, errors = {}, {}
    for model in MODELS:
        fits[model] = fit_camera(views, size, model, start=first)
        errors[model] = held_out_rms(views, size, fits[model])
    chosen = "none"
    for model in MODELS:
        if errors[model] < errors[chosen] * (1 - WORTHWHILE):
            chosen = model
    return fits[chosen], errors


def held_out_rms(views: Sequence[Sighting], size: tuple[int, int], fit: Fit) -> float:
    """RMS in px of views that were not in the fit: their poses are free, the camera is that of the others."""
    folds = min(len(views), MOST_FOLDS)
    views = thinned(views, HELD_OUT_CORNERS)
    total, count = 0.0, 0
    for fold in range(folds):
        kept = [index for index in range(len(views)) if index % folds != fold]
        start = replace(fit, poses=tuple(fit.poses[index] for index in kept))
        others = fit_camera([views[index] for index in kept], size, fit.model, start=start)
        for index in range(fold, len(views), folds):
            view = views[index]
            pose = find_pose(view.object_mm, view.pixels, others.matrix, others.distortion)
            total += pose.rms_px**2 * len(view.pixels)
            count += len(view.pixels)
    return float(np.sqrt(total / count))


def choose_corners(views: Sequence[Sighting], size: tuple[int, int]) -> tuple[list[Sighting], str]:
    """The views with the corner estimate that fits one camera better, and its name."""
    own = list(views)
    sector = [
        view if view.sector_pixels is None else replace(view, pixels=view.sector_pixels, sector_pixels=None)
        for view in views
    ]
    if all(view.sector_pixels is None for view in views):
        return own, "saddle"
    by_saddle, by_sector = fit_camera(own, size, "k1"), fit_camera(sector, size, "k1")
    return (sector, "sector") if by_sector.rms_px < by_saddle.rms_px else (own, "saddle")


def harmful_view(views: Sequence[Sighting], fit: Fit, keep: int | None) -> tuple[int, str] | None:
    """The view that fits worst, if it should be left out, with the reason; never view ``keep``."""
    median = float(np.median(fit.view_rms_px))
    for index in np.argsort(fit.view_rms_px)[::-1]:
        own = fit.view_rms_px[index]
        if own > max(HARMFUL * median, HARMFUL_FLOOR_PX) and index != keep:
            return int(index), (
                f"its corners miss those of the other views by {own:.3f} px (median {median:.3f}): "
                "blurred, bent, or another board"
            )
    for index, view in enumerate(views):
        if index == keep:
            continue
        if find_pose(view.object_mm, view.pixels, fit.matrix, fit.distortion).ambiguous:
            return index, "its two poses, tilted forth and back, explain it nearly equally: tilt the board more"
    return None
