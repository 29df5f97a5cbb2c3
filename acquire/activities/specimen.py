"""Lays something else under the simulated camera while it runs: its scene is computed in a thread, then shown."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

from .background import Background


class Specimen(Background):
    """Takes a second or two; pictures go on with the scene before until then."""

    name: ClassVar[str] = "specimen"

    def __init__(self, show: Callable[[], str]) -> None:
        """``show`` computes and shows the scene and says what lies there now."""
        super().__init__()
        self._show = show

    def begin(self, now_ns: int) -> None:
        """Begin to compute."""
        self.do(self._show, now_ns)
