"""The picture with its frame: what it shows, scale bar, clipping, sharpness, age, and what the link carries."""

from __future__ import annotations

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical

from tui.console.link.rig_view import PictureView, RigView
from tui.console.pictures.raster import Detail, sharpness
from tui.console.widgets.lines import Lines
from tui.console.widgets.picture import LivePicture
from tui.text.width import shorten

OLD_S = 2.0
"""A picture that is older says its age."""
BARS_PX = (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)


class PictureLine(Lines):
    """One line of numbers under the picture."""

    DEFAULT_CSS = "PictureLine { height: 1; }"

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(id="numbers", ascii_only=ascii_only)
        self.picture: PictureView | None = None
        self.cells_wide = 0
        self.sharp = 0.0
        self.link_words = ""

    def text_for(self, width: int) -> Text:
        """Scale bar, range of brightness, clipping, sharpness, link."""
        text = Text(no_wrap=True)
        if self.picture is None:
            return text.append(shorten(self.link_words, width), style="dim")
        header = self.picture.header
        text.append(self._scale_bar(header.source_shape[1])).append("  ")
        share = 100 * header.full_scale_share
        clipped = f"clipped {share:.1f} %" if share >= 0.05 else "nothing clipped" if not share else "clipped <0.1 %"
        text.append(clipped, style="bold red" if share >= 0.05 else "dim")
        for more in (f"{header.low:.0f}..{header.high:.0f}", f"sharp {self.sharp:.1f}", self.link_words):
            if more and text.cell_len + 2 + len(more) <= width:
                text.append(f"  {more}", style="dim")
        return text

    def _scale_bar(self, source_width: int) -> str:
        if not self.cells_wide:
            return ""
        px_per_cell = source_width / self.cells_wide
        px = next((px for px in reversed(BARS_PX) if 3 <= px / px_per_cell <= self.cells_wide / 4), None)
        if px is None:
            return f"{px_per_cell:.0f} px/cell"
        dash, end = ("-", "|") if self.ascii_only else ("─", "│")
        return end + dash * max(1, round(px / px_per_cell) - 2) + end + f" {px} px"


class PicturePane(Vertical):
    """Picture and numbers in one frame."""

    DEFAULT_CSS = """
    PicturePane { height: 1fr; width: 1fr; min-height: 5; border: round $primary 60%;
                  border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, mode: str, ascii_only: bool = False) -> None:
        super().__init__(id="picture")
        self.border_title = "picture"
        self.live = LivePicture(mode)
        self._line = PictureLine(ascii_only=ascii_only)
        self._shown: PictureView | None = None
        self._came_s = 0.0
        self._sharp_s = float("-inf")

    def compose(self) -> ComposeResult:
        """Picture above numbers."""
        yield self.live
        yield self._line

    def offer(self, view: RigView, detail: Detail, *, may_paint: bool, now_s: float) -> bool:
        """Take the newest values; True if a new picture goes to the terminal. Without ``may_paint`` it waits."""
        picture = view.picture if view.connected else None
        fresh = picture is not None and picture is not self._shown
        if fresh and may_paint:
            self._shown, self._came_s = picture, now_s
            self.live.show(picture, "", detail)
            self._measure(self._came_s)
        elif picture is None or self.live.mode == "off":
            self._shown = None
            self.live.show(None, self._words(view))
        self._say(view, now_s)
        return fresh and may_paint and self.live.mode != "off"

    def _measure(self, now_s: float) -> None:
        if self._shown is not None and now_s - self._sharp_s > 0.5:
            self._sharp_s, self._line.sharp = now_s, sharpness(self._shown.pixels)

    def _say(self, view: RigView, now_s: float) -> None:
        self._line.picture = self._shown
        self._line.cells_wide, self._line.link_words = self.live.cells_wide, view.link_words
        self._line.changed()
        title = self._title(now_s)
        if title != self.border_title:
            self.border_title = title

    def _title(self, now_s: float) -> str:
        if self._shown is None:
            return "picture"
        header = self._shown.header
        what = f"frame {header.frame_index}" if header.frame_index >= 0 else "preview"
        age_s = now_s - self._came_s
        old = f"  {age_s:.0f} s old" if age_s > OLD_S else ""
        return f"{what}  {header.exposure_ms:.1f} ms{old}"

    def _words(self, view: RigView) -> str:
        if self.live.mode == "off":
            return "the picture is off\nV turns it on"
        if not view.connected:
            return "not connected"
        status = view.status
        if status is not None and status.activity == "preview":
            return "waiting for the first picture"
        return "no picture yet\nv starts the preview"
