"""Says why a reconstruction has no point, or no crossing, and what to try."""

from __future__ import annotations

import numpy as np

from acquire.contract.calibration import PerFramePlanes
from acquire.contract.messaging.messages import FrameFormat
from process.cloud.cloud import LEFT_OUT, PointCloud
from process.crossings.maps import Maps, full_scale
from process.crossings.quality import Quality

from .settings import Edge, Settings

LEAST_CONTRAST = 5
"""Counts of 8 bit; less is noise."""
OTHER_EDGE_SHARE = 0.5
"""Share of the pixels over the contrast that are beyond half brightness in the first frame already, from which on the
other edge is the one that sweeps."""


def why_nothing(maps: Maps, settings: Settings, cloud: PointCloud | None, form: FrameFormat) -> str:
    """Why there is no point (without a light plane: no crossing), and what to try; empty where there is one."""
    counts = maps.counts
    other = counts["past_s_in_first"] > OTHER_EDGE_SHARE * counts["over_contrast"]
    wrong_edge = other_edge_words(counts, settings.edge) if other else ""
    if counts["crossings"] == 0:
        return f"no pixel has a crossing: {wrong_edge or _why_no_crossing(maps, settings, form)}"
    if cloud is None or len(cloud) > 0:
        return ""
    return f"none of the {counts['crossings']} crossings became a point: {wrong_edge or _why_no_point(maps, settings)}"


def _why_no_crossing(maps: Maps, settings: Settings, form: FrameFormat) -> str:
    counts, count = maps.counts, 2.0 ** (form.bit_depth - 8)
    if counts["over_contrast"] == 0:
        largest = float(np.max(maps.maximum - maps.minimum)) / count
        words = f"no pixel changes by {settings.contrast} counts of 8 bit (--contrast), the most is {largest:.1f}"
        top, full = int(maps.maximum.max(initial=0)), full_scale(form.bit_depth)
        if form.bit_depth > 8 and top * 4 <= full:
            return f"{words}; the values reach {top} of {full}: import with --bit-depth if they have fewer bits"
        if largest < LEAST_CONTRAST:
            return f"{words}: does the light sweep over these pictures?"
        return f"{words}: try --contrast {max(int(0.6 * largest), LEAST_CONTRAST)}"
    if counts["unresolved"]:
        return f"{counts['unresolved']} pixels could not be resolved from the file: run 'sweepscope verify'"
    return "where pixels change, the whole edge could not be fitted: try --method linear"


def _why_no_point(maps: Maps, settings: Settings) -> str:
    crossing, quality = maps.crossing[np.isfinite(maps.crossing)], maps.quality[np.isfinite(maps.crossing)]
    left = crossing[(quality & LEFT_OUT) == 0]
    if not len(left):
        filtered = int(((quality & Quality.FILTERED) != 0).sum())
        return (
            f"{filtered} are filtered as uncertain or lonely, {len(crossing) - filtered} are still within the edge at "
            "the last frame: more light, a longer sweep, or --method linear"
        )
    plane = settings.light_plane
    first, last = float(left.min()) + 1, float(left.max()) + 1
    if isinstance(plane, PerFramePlanes) and (last < plane.first_frame or first > plane.last_frame):
        return (
            f"they are in frames {first:.0f} to {last:.0f} (counted from 1), and the calibration has planes for "
            f"{plane.first_frame} to {plane.last_frame}: it is another sweep's"
        )
    return "the light plane of the calibration meets none of their rays: it is another rig's, or another edge's"


def other_edge(edge: Edge) -> Edge:
    """Rising for falling, falling for rising."""
    return "falling" if edge == "rising" else "rising"


def other_edge_words(counts: dict[str, int], edge: Edge) -> str:
    """Says that the light goes the other way than the edge that was looked for.

    A pixel over the contrast that is beyond half brightness in the first frame has a crossing of the other edge.
    """
    how, first = ("leaves", "bright") if edge == "rising" else ("comes to", "dark")
    return (
        f"{counts['past_s_in_first']} of {counts['over_contrast']} pixels are {first} in the first frame: the light "
        f"{how} them; --edge {other_edge(edge)} has a crossing for them (with a calibration made with that edge)"
    )
