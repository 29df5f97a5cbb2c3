"""The physical limit of a crossing: the Cramer-Rao bound of an erf edge in discrete frames.

Cf. Gatherer 1993, The Cramer-Rao bound for discrete-time edge position.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from process.edge_fit.noise_model import ROUNDING_VARIANCE


def crossing_bound(width: float, contrast: float, noise: float, phase: ArrayLike) -> NDArray[np.float64]:
    """Least standard deviation in frames of an unbiased estimate, everything but the crossing known.

    width: standard deviation of the edge in frames. contrast, noise: height and standard deviation in levels; the
    rounding's 1/12 is added to the noise. phase: fractional part of the crossing, any shape; the exact sum over
    the frames is taken there. For width >= 0.7 it is noise / contrast x sqrt(2 sqrt(pi) width).
    """
    phases = np.asarray(phase, np.float64)
    frames = np.arange(-math.ceil(8 * width) - 2, math.ceil(8 * width) + 3)
    z = (frames - phases[..., None]) / width
    slope = contrast * np.exp(-0.5 * z * z) / (width * math.sqrt(2 * math.pi))
    information: NDArray[np.float64] = (slope**2).sum(axis=-1) / (noise**2 + ROUNDING_VARIANCE)
    return 1.0 / np.sqrt(information)
