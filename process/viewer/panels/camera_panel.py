"""The camera's newest picture beside the scene, and which parts of the rig are drawn in the scene."""

from __future__ import annotations

import numpy as np
import viser
from numpy.typing import NDArray

from acquire.contract.units import NS_PER_S
from process.viewer.rig_client.feed import Snapshot
from process.viewer.scene.scene import RigShown
from process.viewer.status_html import small_html

from .widgets import write

OLD_NS = 2 * NS_PER_S
"""A picture older than this is called old."""
NO_PICTURE = "no picture yet: start a preview or a sweep"
CLIPPED_SHARE = 0.001
"""More of the picture at full scale than this is shown as a warning."""


class CameraPanel:
    """The picture with its age; the image widget is made with the first picture."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._gui = server.gui
        self._words = server.gui.add_html(small_html(NO_PICTURE))
        self._place = server.gui.add_folder("Camera", visible=False)
        self._image: viser.GuiImageHandle | None = None
        with server.gui.add_folder("Drawn in the scene"):
            self._light = server.gui.add_checkbox("Light plane", True)
            self._camera = server.gui.add_checkbox("Camera", True, hint="Its picture hangs over the object")
            self._stage = server.gui.add_checkbox("Stage and travel", True)

    @property
    def shown(self) -> RigShown:
        """What people chose."""
        return RigShown(bool(self._light.value), bool(self._camera.value), bool(self._stage.value))

    def show(self, snapshot: Snapshot, now_ns: int, pixels: NDArray[np.uint8] | None) -> None:
        """Replace the picture if there is a new one; its age always."""
        if pixels is not None:
            rgb = pixels if pixels.ndim == 3 else np.repeat(pixels[:, :, None], 3, axis=2)
            if self._image is None:
                with self._place:
                    self._image = self._gui.add_image(rgb, format="jpeg", jpeg_quality=70)
                write(self._place, visible=True)
            else:
                self._image.image = rgb
        write(self._words, content=small_html(picture_words(snapshot, now_ns)))


def picture_words(snapshot: Snapshot, now_ns: int) -> str:
    """Of when and where the picture is, and whether it is clipped."""
    picture = snapshot.picture
    if picture is None:
        return NO_PICTURE
    age_s = (now_ns - snapshot.picture_ns) // NS_PER_S
    what = f"frame {picture.frame_index:,}" if picture.frame_index >= 0 else "preview"
    parts = [f"{what} at {picture.position_um:,.1f} µm", f"{picture.exposure_ms:g} ms"]
    if picture.full_scale_share > CLIPPED_SHARE:
        parts.append(f"{100 * picture.full_scale_share:.1f} % at full scale")
    old = now_ns - snapshot.picture_ns > OLD_NS
    parts.append(f"{age_s} s old" if old else "live")
    return ", ".join(parts)
