"""Quality bits of a pixel's crossing, uint16. Their values are part of maps.h5 and cloud.ply and never change."""

from __future__ import annotations

from enum import IntFlag


class Quality(IntFlag):
    """Reasons to doubt a pixel's crossing; a bit is set only where the contrast mask is true."""

    LIT_AT_START = 1
    """The first frame is already at or above S: no crossing."""
    PLATEAU_NOT_REACHED = 2
    """The sweep ended within the edge, with the pixel still bright: the maximum, and so S, is too low."""
    NO_DARK_LEVEL = 4
    """The sweep began within the edge, or the pixel never got below half of full scale."""
    SATURATED = 8
    """The maximum is full scale: the plateau, and so S, is too low."""
    SEVERAL = 16
    """After the crossing the pixel got dark again and rose once more."""
    FROM_FILE = 32
    """Resolved from the scan file, because the bounded log had no room for all its new maxima."""
    MISSING_NEIGHBOUR = 64
    """A frame is missing between the two that the crossing lies between."""
    FILTERED = 128
    """Left out of the cloud by a filter (sigma, isolation)."""
    OTHER_LIGHT = 256
    """The crossing, or the maximum that S depends on, lies in a frame that was taken after the light had changed."""
