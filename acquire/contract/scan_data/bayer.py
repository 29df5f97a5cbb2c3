"""Bayer frames are stored raw and turned into RGB by their readers. The one table of the patterns."""

from __future__ import annotations

from typing import Any, Final

import cv2
import numpy as np
from numpy.typing import NDArray

BAYER: Final = {
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB,
    "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_grbg": cv2.COLOR_BayerGRBG2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB,
}
"""Pixel format -> OpenCV's bilinear conversion; the letters name the colours of the first 2 x 2 pixels by row."""


def demosaiced(pixels: NDArray[Any], pixel_format: str) -> NDArray[Any]:
    """Stored pixels as [h, w] grey or [h, w, 3] RGB: Bayer frames are interpolated, others returned as they are."""
    code = BAYER.get(pixel_format)
    return pixels if code is None else np.asarray(cv2.cvtColor(np.ascontiguousarray(pixels), code))
