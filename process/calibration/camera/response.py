"""Response of a camera to light: gamma and black level from an exposure series, and their effect on crossings.

Model: counts = black + k (light)^gamma, counts of 8 bit, k of each group of pixels free.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import CalibrationError

F8 = NDArray[np.float64]
GROUPS = 48
"""Groups of pixels of like brightness that are averaged."""
MIN_EXPOSURES = 4
MIN_RANGE = 3.0
"""Longest over shortest exposure that is needed."""
SATURATED_SHARE = 0.98
"""Share of full scale beyond which a group is left out."""
DARK_COUNTS = 4.0
"""Counts of 8 bit above black below which a group is left out: rounding dominates."""
GAMMA_LIMIT = 0.03
LINEARITY_LIMIT = 0.02
STRAY_SHARE = 0.4
"""Dark over bright level of a pixel in strong stray light, for the example in the result."""
ROUNDS = 60


@dataclass(frozen=True)
class Response:
    """counts = black + k (light)^gamma."""

    gamma: float
    gamma_sd: float
    black_counts: float
    """Counts of 8 bit without light."""
    nonlinearity: float
    """Greatest departure from a straight line, as a share of the brightest level used."""
    exposures: int
    saturated_share: float
    """Of all pixels in the longest exposure."""

    @property
    def linear(self) -> bool:
        """True if half brightness is half of the light, within the limits."""
        return abs(self.gamma - 1) <= max(GAMMA_LIMIT, 3 * self.gamma_sd) and self.nonlinearity <= LINEARITY_LIMIT

    def shift_widths(self, stray: float = 0.0) -> float:
        """Delay of half of the counts after half of the light, in widths of a rising edge.

        ``stray``: light before the edge over light after it.
        """
        half = ((stray**self.gamma + 1) / 2) ** (1 / self.gamma)
        return NormalDist().inv_cdf(min(max((half - stray) / (1 - stray), 1e-9), 1 - 1e-9))

    def lines(self, width_um: float) -> list[str]:
        """The result as lines of text; ``width_um``: standard deviation of a light edge in um of travel."""
        lines = [
            f"gamma {self.gamma:.3f} +- {self.gamma_sd:.3f}, black at {self.black_counts:.1f} of 255, at most "
            f"{100 * self.nonlinearity:.1f} % off a straight line over {self.exposures} exposures"
        ]
        clear, stray = self.shift_widths(), self.shift_widths(STRAY_SHARE)
        if self.linear:
            return [*lines, "the camera is linear: half brightness is half of the light"]
        lines += [
            f"NOT linear: half of the counts comes {clear:+.2f} widths of the edge late ({clear * width_um:+.1f} um of "
            f"travel at a width of {width_um:g} um)",
            f"a calibration takes that out, but not where stray light differs: at {100 * STRAY_SHARE:.0f} % of it "
            f"that is {stray:+.2f} widths, so such points are {(stray - clear) * width_um:+.1f} um of travel off",
            "switch gamma (and automatic contrast) off in the camera, and look at this again",
        ]
        return lines


def find_response(exposures_ms: Sequence[float], pictures: Sequence[NDArray[np.generic]], bit_depth: int) -> Response:
    """Gamma and black level from pictures of one unmoved scene.

    Args:
        exposures_ms: of each picture.
        pictures: [h, w] or [h, w, 3] each; colour is averaged.
        bit_depth: of the samples.

    Raises:
        CalibrationError: too few or too similar exposures, sizes that differ, or all dark or saturated.
    """
    order = np.argsort(exposures_ms)
    t = np.array(exposures_ms, dtype=np.float64)[order]
    if len(np.unique(t)) < MIN_EXPOSURES or t[0] <= 0 or t[-1] / t[0] < MIN_RANGE:
        raise CalibrationError(
            f"it takes {MIN_EXPOSURES} exposures or more over a range of 1 : {MIN_RANGE:g}; "
            f"{len(np.unique(t))} were given" + (f" over 1 : {t[-1] / t[0]:.1f}" if len(t) and t[0] > 0 else "")
        )
    if len({picture.shape for picture in pictures}) != 1:
        raise CalibrationError("the pictures differ in size: take them with one camera, which is not moved")
    full = float(2**bit_depth - 1)
    stack = np.stack([_grey(pictures[index]) for index in order]) * (255.0 / full)
    levels, used = _groups(stack)
    if int(used.sum()) < 2 * len(t) or (used.sum(axis=1) >= 2).sum() < MIN_EXPOSURES:
        raise CalibrationError("too little of the series is neither dark nor saturated: change the light or exposures")
    return _fitted(t, levels, used, float((stack[-1] >= SATURATED_SHARE * 255).mean()))


def _grey(picture: NDArray[np.generic]) -> F8:
    values = picture.astype(np.float64)
    return np.asarray(values if values.ndim == 2 else values.mean(axis=2))


def _groups(stack: F8) -> tuple[F8, NDArray[np.bool_]]:
    """Mean level [exposures, groups] of pixels of like brightness, and where it is neither dark nor saturated."""
    flat = stack.reshape(len(stack), -1)
    # ordered by a middle exposure, so that noise of the others does not choose
    order = np.argsort(flat[len(flat) // 2], kind="stable")
    parts = np.array_split(order, min(GROUPS, max(len(order) // 20, 1)))
    levels = np.stack([flat[:, part].mean(axis=1) for part in parts], axis=1)
    saturated = np.stack([(flat[:, part] >= SATURATED_SHARE * 255).mean(axis=1) > 0.002 for part in parts], axis=1)
    return levels, ~saturated & (levels > levels.min() + DARK_COUNTS)


def _fitted(t: F8, levels: F8, used: NDArray[np.bool_], saturated: float) -> Response:
    """Gauss-Newton iteration over black level and gamma; the factor of each group follows from them."""
    x, step = np.array([max(float(levels.min()) - 1.0, 0.0), 1.0]), np.array([1e-3, 1e-4])
    for _ in range(ROUNDS):
        off = _residual(x, t, levels, used)
        jacobian = np.column_stack([
            (_residual(x + np.eye(2)[k] * step[k], t, levels, used) - off) / step[k] for k in (0, 1)
        ])  # fmt: skip
        change = -np.linalg.lstsq(jacobian, off, rcond=None)[0]
        x += np.clip(change, [-5.0, -0.2], [5.0, 0.2])
        x[1] = min(max(x[1], 0.1), 5.0)
        if np.abs(change).max() < 1e-7:
            break
    off = _residual(x, t, levels, used)
    freedom = max(len(off) - 2 - levels.shape[1], 1)
    covariance = np.linalg.pinv(jacobian.T @ jacobian) * float(off @ off) / freedom
    straight = _residual(np.array([x[0], 1.0]), t, levels, used)
    return Response(
        gamma=float(x[1]),
        gamma_sd=float(np.sqrt(covariance[1, 1])),
        black_counts=float(x[0]),
        nonlinearity=float(np.abs(straight).max() / (levels[used].max() - x[0])),
        exposures=len(t),
        saturated_share=saturated,
    )


def _residual(x: F8, t: F8, levels: F8, used: NDArray[np.bool_]) -> F8:
    """Measured minus model counts of the used levels, with the factor k of each group by least squares."""
    light = (t ** x[1])[:, None] * used
    above = (levels - x[0]) * used
    factor = (light * above).sum(axis=0) / np.maximum((light**2).sum(axis=0), 1e-300)
    return np.asarray((above - light * factor)[used])
