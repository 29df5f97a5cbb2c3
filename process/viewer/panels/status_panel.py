"""The text beside the scene: the state, what is missing, and a clock that proves that the page is alive."""

from __future__ import annotations

import time

import viser

from acquire.contract.units import NS_PER_S
from process.viewer.rig_client.feed import Snapshot
from process.viewer.status_html import STYLE, SceneFacts, html_of, status_html

from .widgets import write

BEAT_NS = NS_PER_S


class StatusPanel:
    """Shows the HTML of :mod:`process.viewer.status_html`; a view-only page has no other panel."""

    def __init__(self, server: viser.ViserServer, *, view_only: bool) -> None:
        self._view_only = view_only
        self._beat_ns = 0
        server.gui.configure_theme(
            dark_mode=True, show_logo=False, show_share_button=False, control_width="medium", brand_color=(47, 111, 168)
        )
        server.gui.main_panel.dock_right()
        server.gui.add_html(STYLE)  # apart from the text: a browser restyles the whole page when it comes anew
        self._beat = server.gui.add_html("")
        self._text = server.gui.add_html("")

    def show(self, snapshot: Snapshot, now_ns: int, scene: SceneFacts) -> None:
        """Write what changed; the clock once a second."""
        write(self._text, content=status_html(snapshot, now_ns, scene))
        if now_ns - self._beat_ns >= BEAT_NS:
            self._beat_ns = now_ns
            self._beat.content = html_of("heartbeat.html", clock=time.strftime("%H:%M:%S"), view_only=self._view_only)
