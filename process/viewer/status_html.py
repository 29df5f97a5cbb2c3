"""The status of rig, results and scene as HTML rows beside the scene, from ``templates/``. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from acquire.contract.colormaps import LEVELS, table
from acquire.contract.messaging.messages import Status
from acquire.contract.states import RUNNING_STATES
from acquire.contract.units import NS_PER_S, format_bytes, format_duration
from process.html_templates import render
from process.viewer.rig_client.commands import CommandNote
from process.viewer.rig_client.feed import Snapshot
from process.viewer.stream.browser_stream import StreamStats
from process.viewer.stream.colouring import PROVISIONAL_RGB, Legend

from .status_text import heading, remarks, saved_line, scan_name

NOTE_SHOWN_NS = 30 * NS_PER_S
_TEMPLATES = Path(__file__).with_name("templates")
STYLE = f"<style>\n{(_TEMPLATES / 'style.css').read_text(encoding='utf-8')}</style>"
_SWATCH = Markup('<span class="sw-swatch" style="background:rgb({},{},{})"></span>').format(*PROVISIONAL_RGB)


@dataclass(frozen=True)
class SceneFacts:
    """What the page says about the drawing."""

    keep_one_of: int = 1
    """1: all points are shown; n: one of n, spread evenly."""
    floor_cell_mm: float = 0.0
    """Side of a cell of the floor; 0: there is none."""
    streams: tuple[StreamStats, ...] = ()
    """One for each browser."""
    opened: str = ""
    """The older scan that is shown instead of the rig's; empty: the rig's."""


def html_of(template: str, **values: Any) -> str:
    """One of the page's templates with values put in; they are escaped."""
    return render(_TEMPLATES / template, **values)


def status_html(snapshot: Snapshot, now_ns: int, scene: SceneFacts) -> str:
    """State, progress, numbers, faults and what is missing."""
    status, progress = snapshot.status, snapshot.progress
    head, saved = heading(snapshot, now_ns), saved_line(status) if status is not None else ""
    return html_of(
        "status.html",
        data={  # what a program wants to read off the page
            "live": str(head.live).lower(),
            "state": status.state if status is not None else "",
            "folded-through": progress.folded_through if progress is not None else -1,
            "cloud-through": snapshot.cloud_folded_through,
        },
        head=head,
        scan_name=scan_name(status) if status is not None else "",
        said=status.message if status is not None and status.message != saved else "",
        faults=status.faults if status is not None else (),
        opened=scene.opened,
        bars=_bars(snapshot),
        rows=_numbers(snapshot) + _drawing(scene) if status is not None else (),
        saved=saved,
        remarks=remarks(snapshot, now_ns, scene.keep_one_of),
    )


def note_html(note: CommandNote, now_ns: int) -> str:
    """What became of the last click; empty when it is long ago."""
    if not note.text or now_ns - note.at_ns > NOTE_SHOWN_NS:
        return ""
    return html_of("command_note.html", note=note)


def small_html(text: str, strong: str = "") -> str:
    """A line in small letters, its beginning ``strong``; empty without words."""
    return html_of("small.html", text=text, strong=strong) if text else ""


def legend_html(legend: Legend | None) -> str:
    """Title, unit, histogram, bar and ticks of the shown quantity; empty for a photograph."""
    if legend is None:
        return ""
    ticks = [legend.low + (legend.high - legend.low) * part / 4 for part in range(5)]
    return html_of(
        "legend.html",
        legend=legend,
        shades=[f"rgb({','.join(map(str, shade))})" for shade in table(legend.map_name)[:: LEVELS // 16].tolist()],
        ticks=[f"{tick:,.{legend.decimals}f}" for tick in ticks],
    )


def _bars(snapshot: Snapshot) -> list[float]:
    """Percent of the frames that are saved and folded; empty without a scan."""
    status, progress = snapshot.status, snapshot.progress
    if status is None or not status.expected:
        return []
    same_scan = snapshot.cloud_scan_uid in ("", status.scan_uid)
    folded = progress.folded_through + 1 if progress is not None and same_scan else 0
    return [min(100.0, 100 * count / status.expected) for count in (status.committed, folded)]


def _numbers(snapshot: Snapshot) -> list[tuple[str, str]]:
    status, progress = snapshot.status, snapshot.progress
    rows: list[tuple[str, str]] = []
    if status is not None and status.expected:
        rows.append(("Frames saved", f"{status.committed:,} of {status.expected:,}{_flaws(status)}"))
    if progress is not None:
        behind = f", {progress.lag_frames} behind" if progress.lag_frames else ""
        rows.append(("Folded", f"{progress.folded_through + 1:,} of {progress.expected:,}{behind}"))
    if status is not None and status.state in RUNNING_STATES:
        rows.append(("Rate", f"{status.rate_hz:.1f} frames/s"))
        rows.append(("Remaining", f"{format_duration(status.eta_s)} h:m:s"))
    if progress is not None:
        rows.append(("Points, settled", f"{progress.points_settled:,}"))
        rows.append((_SWATCH + "provisional", f"{progress.points_provisional:,}"))
    if status is not None:
        trust = "" if status.position_trusted else " (not trusted)"
        rows.append(("Stage", f"{status.position_um:,.1f} µm{trust}"))
    return rows


def _flaws(status: Status) -> str:
    missing = f", {status.missing:,} missing" if status.missing else ""
    return missing + (f", {status.retaken:,} taken again" if status.retaken else "")


def _drawing(scene: SceneFacts) -> list[tuple[str, str]]:
    rows = [("Floor, z = 0", f"{scene.floor_cell_mm:g} mm cells")] if scene.floor_cell_mm else []
    if scene.streams:
        rows.append(("Browsers", _streams_text(scene.streams)))
    return rows


def _streams_text(streams: tuple[StreamStats, ...]) -> str:
    sent = format_bytes(sum(stream.bytes_per_s for stream in streams))
    slow = sum(stream.slow for stream in streams)
    return f"{len(streams)}, {sent}/s" + (f", {slow} slow: overview first" if slow else "")
