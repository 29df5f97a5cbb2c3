"""Choices by the data: number of distortion terms, estimate of the corners, views that are left out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from process.calibration.board.detection import Sighting
from process.calibration.board.poses import find_pose

from .bundle import MODELS, CameraFit, fit_camera, thinned

MOST_FOLDS = 10
HELD_OUT_CORNERS = 300
WORTHWHILE = 0.002
"""Least share by which a model with more terms has to lower the held-out error."""
COMPARABLE = 1.2
"""Estimates of the corners whose residuals differ by more are not averaged: the worse one would add its bias."""
SURE = 1.0
"""Standard deviations from zero beyond which the first radial term is taken without a lower held-out error: where no
view was, points are then nearer to the truth with it."""
HARMFUL = 3.0
"""A view whose residual is so many times the median of all does not show the same board."""
HARMFUL_FLOOR_PX = 0.05
MIN_VIEWS = 3
K1 = 4
"""Index of the first radial term among the intrinsics."""


def choose_model(
    views: Sequence[Sighting], size: tuple[int, int], start: CameraFit | None = None
) -> tuple[CameraFit, dict[str, float]]:
    """The fit with the distortion model that predicts held-out views best, and the held-out RMS of each model in px.

    A model with more terms is taken only if it predicts clearly better: by WORTHWHILE, and for more than the first
        radial term also by more than the standard error of the difference over the views; terms fitted to chance are
        far off where no board was. The first term is also taken if it is larger than its uncertainty: a small board in
        the middle of the field hardly shows it, and at the corners it is microns. Left out, it remains as an
        uncertainty.
    """
    first = fit_camera(views, size, "k1", start)
    fits, squares = {}, {}
    for model in MODELS:
        fits[model] = fit_camera(views, size, model, start=first)
        squares[model] = held_out(views, size, fits[model])
    chosen = "none"
    for model in MODELS:
        gain = squares[chosen] - squares[model]
        doubt = float(gain.std(ddof=1)) / np.sqrt(len(gain)) if len(gain) > 1 else 0.0
        if model == "k1":
            doubt = 0.0
        better = gain.mean() > max(2 * WORTHWHILE * float(squares[chosen].mean()), doubt)
        if better or (model == "k1" and _sure_of_k1(fits[model])):
            chosen = model
    if chosen == "none":
        fits[chosen] = replace(fits[chosen], covariance=without_k1(fits["k1"]))
    return fits[chosen], {model: float(np.sqrt(found.mean())) for model, found in squares.items()}


def _sure_of_k1(fit: CameraFit) -> bool:
    return bool(abs(fit.intrinsics[K1]) > SURE * np.sqrt(fit.covariance[K1, K1]))


def without_k1(fit: CameraFit) -> NDArray[np.float64]:
    """Covariance [9, 9] of a camera without first radial term: that of ``fit``, and what leaving the term out does."""
    answer = fit.covariance[:, K1] / max(float(fit.covariance[K1, K1]), 1e-300)
    return np.asarray(fit.covariance + fit.intrinsics[K1] ** 2 * np.outer(answer, answer), dtype=np.float64)


def held_out(views: Sequence[Sighting], size: tuple[int, int], fit: CameraFit) -> NDArray[np.float64]:
    """Mean square in px^2 of each view, its pose fitted with the camera of the other views."""
    folds = min(len(views), MOST_FOLDS)
    views = thinned(views, HELD_OUT_CORNERS)
    found = np.zeros(len(views))
    for fold in range(folds):
        kept = [index for index in range(len(views)) if index % folds != fold]
        start = replace(fit, poses=tuple(fit.poses[index] for index in kept))
        others = fit_camera([views[index] for index in kept], size, fit.model, start=start)
        for index in range(fold, len(views), folds):
            view = views[index]
            found[index] = find_pose(view.object_mm, view.pixels, others.matrix, others.distortion).rms_px ** 2
    return found


def choose_corners(
    views: Sequence[Sighting], size: tuple[int, int], wanted: str = "auto", model: str = "k1"
) -> tuple[list[Sighting], str]:
    """The views with one estimate of their corners, and the estimate that most of them have.

    ``auto`` takes the estimate that fits one camera with the distortion ``model`` best, or its mean with the second
    best, weighted by the inverse variances, if both are comparable and the mean fits better: their errors are partly
    independent. A view without an estimate keeps its own corners; its ``estimate`` says so.
    """
    if wanted != "auto":
        chosen = _with_corners(views, wanted)
        return chosen, _usual(chosen)
    own = _usual(views)
    names = [own, *(name for name in ("sector", "gradient") if any(name in view.others for view in views))]
    by_name = {name: _with_corners(views, name) for name in dict.fromkeys(names)}
    rms = {name: _rms_px(chosen, size, model) for name, chosen in by_name.items()}
    best, *others = sorted(by_name, key=rms.__getitem__)
    if not others or rms[others[0]] > COMPARABLE * rms[best]:
        return by_name[best], best
    second = others[0]
    share = rms[second] ** 2 / (rms[best] ** 2 + rms[second] ** 2)
    blend = [_mean(one, two, share) for one, two in zip(by_name[best], by_name[second], strict=True)]
    if _rms_px(blend, size, model) < rms[best]:
        return blend, f"{best} + {second}"
    return by_name[best], best


def _rms_px(views: Sequence[Sighting], size: tuple[int, int], model: str) -> float:
    first = fit_camera(views, size, "k1")
    return first.rms_px if model == "k1" else fit_camera(views, size, model, start=first).rms_px


def _usual(views: Sequence[Sighting]) -> str:
    return Counter(view.estimate for view in views).most_common(1)[0][0]


def _mean(one: Sighting, two: Sighting, share: float) -> Sighting:
    """The view with ``share`` of the corners of ``one`` and the rest of ``two``."""
    if one.estimate == two.estimate:
        return one
    pixels = share * one.pixels + (1 - share) * two.pixels
    return replace(one, pixels=pixels, estimate=f"{one.estimate} + {two.estimate}")


def _with_corners(views: Sequence[Sighting], name: str) -> list[Sighting]:
    return [
        replace(view, pixels=view.others[name], others={}, estimate=name)
        if name in view.others
        else replace(view, others={})
        for view in views
    ]


def harmful_view(views: Sequence[Sighting], fit: CameraFit, keep: int | None) -> tuple[int, str] | None:
    """Index of a view that should be left out, and the reason; None if there is none. Never view ``keep``."""
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
