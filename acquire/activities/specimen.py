"""Lays another specimen under the simulated camera: its scene is computed in a thread, then shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from .background import Background


class Specimen(Background):
    """Takes a second or two; until then pictures show the scene before."""

    name: ClassVar[str] = "specimen"

    def __init__(self, show: Callable[[], str]) -> None:
        """``show`` computes and shows the scene, and describes it."""
        super().__init__()
        self._show = show

    def begin(self, now_ns: int) -> None:
        """Begin to compute."""
        self.do(self._show, now_ns)
