"""The picture with its frame: what it shows, scale bar, clipping, sharpness, age, and the rate of the link."""

from __future__ import annotations

from dataclasses import dataclass

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Vertical

from tui.console.link.rig_view import PictureView, RigView
from tui.console.pictures.raster import PictureDetail, sharpness
from tui.console.widgets.lines import Lines
from tui.console.widgets.picture import LivePicture
from tui.text.width import shorten

OLD_S = 2.0
"""From this age on a picture shows its age."""
SHARPNESS_EVERY_S = 0.5
BARS_PX = (5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000)


@dataclass(frozen=True)
class PictureNumbers:
    """What the line under the picture shows."""

    picture: PictureView | None = None
    cells_wide: int = 0
    sharp: float = 0.0
    link_words: str = ""


class PictureLine(Lines[PictureNumbers]):
    """One line of numbers under the picture."""

    DEFAULT_CSS = "PictureLine { height: 1; }"

    def text_for(self, width: int) -> Text:
        """Scale bar, clipping, range of brightness, sharpness, link."""
        numbers, text = self.shown, Text(no_wrap=True)
        if numbers.picture is None:
            return text.append(shorten(numbers.link_words, width), style="dim")
        header = numbers.picture.header
        text.append(_scale_bar(header.source_shape[1], numbers.cells_wide)).append("  ")
        share = 100 * header.full_scale_share
        clipped = f"clipped {share:.1f} %" if share >= 0.05 else "nothing clipped" if not share else "clipped <0.1 %"
        text.append(clipped, style="bold red" if share >= 0.05 else "dim")
        for more in (f"{header.low:.0f}..{header.high:.0f}", f"sharp {numbers.sharp:.1f}", numbers.link_words):
            if more and text.cell_len + 2 + len(more) <= width:
                text.append(f"  {more}", style="dim")
        return text


def _scale_bar(source_width: int, cells_wide: int) -> str:
    if not cells_wide:
        return ""
    px_per_cell = source_width / cells_wide
    px = next((px for px in reversed(BARS_PX) if 3 <= px / px_per_cell <= cells_wide / 4), None)
    if px is None:
        return f"{px_per_cell:.0f} px/cell"
    return "│" + "─" * max(1, round(px / px_per_cell) - 2) + f"│ {px} px"


class PicturePane(Vertical):
    """Picture and numbers in one frame."""

    DEFAULT_CSS = """
    PicturePane { height: 1fr; width: 1fr; min-height: 5; border: round $primary 60%;
                  border-title-color: $text-muted; padding: 0 1; }
    """

    def __init__(self, *, mode: str) -> None:
        super().__init__()
        self.border_title = "picture"
        self.live = LivePicture(mode)
        self._line = PictureLine(PictureNumbers())
        self._shown: PictureView | None = None
        self._arrived_s = 0.0
        self._sharp = 0.0
        self._sharp_s = float("-inf")

    def compose(self) -> ComposeResult:
        """Picture above numbers."""
        yield self.live
        yield self._line

    def offer(self, view: RigView, detail: PictureDetail, *, may_paint: bool, now_s: float) -> bool:
        """Take the newest values; True if a new picture goes to the terminal. Without ``may_paint`` it waits."""
        picture = view.picture if view.connected else None
        paint = picture is not None and picture is not self._shown and may_paint
        if picture is not None and paint:
            self._shown, self._arrived_s = picture, now_s
            self.live.show(picture, "", detail)
            if now_s - self._sharp_s > SHARPNESS_EVERY_S:
                self._sharp_s, self._sharp = now_s, sharpness(picture.pixels)
        elif picture is None or self.live.mode == "off":
            self._shown = None
            self.live.show(None, self._words(view))
        self._line.show(PictureNumbers(self._shown, self.live.size_cells[1], self._sharp, view.link_words))
        title = self._title(now_s)
        if title != self.border_title:
            self.border_title = title
        return paint and self.live.mode != "off"

    def _title(self, now_s: float) -> str:
        if self._shown is None:
            return "picture"
        header = self._shown.header
        what = f"frame {header.frame_index}" if header.frame_index >= 0 else "preview"
        age_s = now_s - self._arrived_s
        old = f"  {age_s:.0f} s old" if age_s > OLD_S else ""
        return f"{what}  {header.exposure_ms:.1f} ms{old}"

    def _words(self, view: RigView) -> str:
        if self.live.mode == "off":
            return "the picture is off\nV turns it on"
        if not view.connected:
            return "not connected"
        if view.status is not None and view.status.activity == "preview":
            return "waiting for the first picture"
        return "no picture yet\nv starts the preview"
