"""What is known of the rig at one moment, as one frozen value for every screen; pure."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.messages import Picture, ResultMaps, ResultProgress, Status
from acquire.contract.rig_client.feed import picture_pixels


@dataclass(frozen=True, eq=False)
class PictureView:
    """One picture for people with its numbers."""

    header: Picture
    pixels: NDArray[np.uint8]
    """[h, w] grey or [h, w, 3] RGB."""

    @classmethod
    def of(cls, header: Picture, payload: bytes | memoryview) -> PictureView:
        """The picture of a message's two parts.

        Raises:
            ProtocolError: as :func:`picture_pixels`.
        """
        return cls(header, picture_pixels(header, payload))


@dataclass(frozen=True, eq=False)
class MapsView:
    """The sampled maps of the sweep so far."""

    header: ResultMaps
    minimum: NDArray[np.uint16]
    """[h, w] in counts of the stored depth."""
    maximum: NDArray[np.uint16]
    """[h, w] in counts of the stored depth."""
    crossing: NDArray[np.float32]
    """[h, w] fractional 0-based frame index; NaN where there is none."""

    @classmethod
    def of(cls, header: ResultMaps, payload: bytes | memoryview) -> MapsView:
        """The maps of a message's two parts.

        Raises:
            ProtocolError: the payload does not hold three maps of the shape that the header says.
        """
        count = header.shape[0] * header.shape[1]
        if len(payload) != 8 * count:
            raise ProtocolError(f"maps of shape {header.shape} with {len(payload)} bytes")
        minimum = np.frombuffer(payload, "<u2", count).reshape(header.shape)
        maximum = np.frombuffer(payload, "<u2", count, 2 * count).reshape(header.shape)
        crossing = np.frombuffer(payload, "<f4", count, 4 * count).reshape(header.shape)
        return cls(header, minimum, maximum, crossing)


@dataclass(frozen=True, eq=False)
class RigView:
    """Everything that a screen may show. None: nothing has come of it yet."""

    status: Status | None = None
    progress: ResultProgress | None = None
    picture: PictureView | None = None
    """The newest camera picture; only screens that ask for pictures get fresh ones."""
    maps: MapsView | None = None
    """The newest sampled maps of the running or last scan."""
    connected: bool = False
    """True while the daemon sends its status; otherwise everything here is what was last known."""
    url: str = ""
    """Address of the page; empty while no viewer runs."""
    stop_words: str = ""
    """``STOP sent`` and the like until the rig's own state has confirmed the stop; empty otherwise."""
    me: str = ""
    """This console as the rig knows it: ``anna on pts/3``."""
    link_words: str = ""
    """The terminal's measured link: ``180 kB/s, picture 3 Hz``; empty while there is nothing to say."""

    @property
    def in_control(self) -> bool:
        """True if no other client holds control."""
        return self.status is None or self.status.control in ("", self.me)
