"""Pure: the second part of a message as arrays; what does not fit its header is refused."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging.lanes import Received
from acquire.contract.messaging.messages import Picture, ResultTiles

from .tile import Tile, parse_tiles


def pixels_of(received: Received, message: Picture) -> NDArray[np.uint8]:
    """The pixels of a picture, copied out of the message.

    Raises:
        ProtocolError: they are not as many as the header says, or have another number of channels than 1 or 3.
    """
    payload = received.payload.buffer if received.payload is not None else b""
    shape = tuple(message.shape)
    if len(payload) != math.prod(shape) or (len(shape) == 3 and shape[2] != 3):
        raise ProtocolError(f"{len(payload)} bytes of pixels where {message.shape} were announced")
    return np.frombuffer(payload, np.uint8).reshape(shape).copy()


def points_of(received: Received) -> tuple[dict[int, Tile], int]:
    """Tiles and how many points were not finite; none of either for other messages.

    Raises:
        ProtocolError: as :func:`parse_tiles`.
    """
    if not isinstance(received.message, ResultTiles):
        return {}, 0
    payload = received.payload.buffer if received.payload is not None else b""
    return parse_tiles(received.message, payload)
