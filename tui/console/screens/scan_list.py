"""Lists the folder of scans again and again for a screen, in a thread and only while the screen is in view."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

from acquire.contract.errors import SweepscopeError
from tui.console.screens.base import RigScreenBase
from tui.scans.folder import ScanEntry, ScanFolder

POLL_S = 2.0


class ScanList:
    """The newest list; one listing runs at a time, however slow the disk is."""

    def __init__(self, screen: RigScreenBase, on_change: Callable[[], Any]) -> None:
        """``on_change`` is called after each listing."""
        self.folder = screen.shell.options.data_dir
        self.entries: list[ScanEntry] = []
        """The newest first."""
        self.problem: str | None = None
        """Why the folder cannot be listed; empty if it can; None before the first listing."""
        self._screen, self._on_change = screen, on_change
        self._scans = ScanFolder(self.folder)
        self._is_listing = False

    def begin(self) -> None:
        """The screen was mounted."""
        self._screen.set_interval(POLL_S, lambda: self.update() if self._screen.is_current else None)
        self.update()

    def update(self) -> None:
        """List the folder now."""
        if not self._is_listing:
            self._is_listing = True
            self._screen.run_worker(self._list(), exit_on_error=False)

    async def _list(self) -> None:
        try:
            self.entries, self.problem = await asyncio.to_thread(self._scans.look), ""
        except (SweepscopeError, OSError) as error:
            self.problem = str(error)
        finally:
            self._is_listing = False
        self._on_change()
