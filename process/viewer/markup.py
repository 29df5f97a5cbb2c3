"""Pure: the text of the panel as HTML; every word that comes from outside is escaped here."""

from __future__ import annotations

from dataclasses import dataclass
from html import escape

from acquire.contract.colormaps import LEVELS, table
from acquire.contract.messaging.messages import FaultReport, Status
from acquire.contract.states import RUNNING_STATES
from acquire.contract.units import NS_PER_S, format_bytes, format_duration
from process.viewer.rig_client.commands import CommandNote
from process.viewer.rig_client.feed import Snapshot
from process.viewer.stream.colouring import PROVISIONAL_RGB, Legend
from process.viewer.stream.streams import LinkNews

from .status_text import Heading, Remark, heading, remarks, saved_line, scan_name

DEAD_PAGE_S = 4
"""A page that has not been beaten for so long covers itself with a warning, by its style sheet alone."""
NOTE_SHOWN_NS = 30 * NS_PER_S
_GLYPHS = {"note": "i", "warning": "!", "fault": "✖"}

STYLE = f"""<style>
.sw {{ font: 13px/1.45 system-ui, "DejaVu Sans", sans-serif; color: #d7dce4; padding: .35em .9em .5em; }}
.sw b, .sw .num {{ font-variant-numeric: tabular-nums; }}
.sw-state {{ display: flex; align-items: baseline; gap: .5em; font-size: 1.45em; font-weight: 650; color: #f4f6fa; }}
.sw-state .glyph {{ color: #58b7ff; width: 1.1em; text-align: center; }}
.sw-old {{ opacity: .5; }}
.sw-name {{ color: #9aa4b2; margin: .1em 0 .6em; overflow-wrap: anywhere; }}
.sw-said {{ color: #c3cad5; margin: -.3em 0 .6em; overflow-wrap: anywhere; }}
.sw-bar {{ position: relative; height: 8px; border-radius: 4px; background: #2a303b; overflow: hidden; }}
.sw-bar i {{ position: absolute; inset: 0 auto 0 0; background: #2f6fa8; }}
.sw-bar i + i {{ top: 5px; background: #7fd1ff; }}
.sw table {{ width: 100%; border-collapse: collapse; margin-top: .6em; }}
.sw td {{ padding: .12em 0; vertical-align: top; }}
.sw td:first-child {{ color: #9aa4b2; padding-right: .8em; white-space: nowrap; }}
.sw td:last-child {{ text-align: right; }}
.sw-swatch {{ display: inline-block; width: .75em; height: .75em; border-radius: 50%; margin-right: .35em; }}
.sw-box {{ border-left: 3px solid #58b7ff; background: #1d2430; border-radius: 3px;
  padding: .45em .65em; margin: .5em 0 0; }}
.sw-box .mark {{ font-weight: 700; margin-right: .35em; }}
.sw-warning {{ border-color: #e8b339; }}
div.sw-fault {{ margin-bottom: .7em; border-color: #ff6b5e; background: #35191a; }}
.sw-saved {{ border-color: #56c271; font-weight: 600; }}
.sw-bins {{ display: flex; align-items: flex-end; gap: 1px; height: 26px; margin-top: .4em; }}
.sw-bins i {{ flex: 1; background: #5d6878; min-height: 1px; }}
.sw-map {{ height: 12px; border-radius: 2px; }}
.sw-ticks {{ display: flex; justify-content: space-between; font-size: 11px; color: #c3cad5; }}
.sw-beat {{ color: #7d8796; font-size: 11px; }}
.sw-dead {{ visibility: hidden; color: #fff; background: #a3231b; border-radius: 3px; padding: 0 .7em;
  animation: sw-dead 0s linear {DEAD_PAGE_S}s forwards; height: 0; overflow: hidden; }}
@keyframes sw-dead {{ to {{ visibility: visible; height: auto; padding: .5em .7em; }} }}
</style>"""


@dataclass(frozen=True)
class Picture:
    """What the legend says about the drawing."""

    keep_one_of: int = 1
    """1: all points are shown; n: one of n, spread evenly."""
    floor_cell_mm: float = 0.0
    """Side of a cell of the floor; 0: there is none."""
    points: int = 0
    """Points of the cloud, shown or not."""
    legend: Legend | None = None
    """What the colours mean; None: they are those of the photograph."""
    links: tuple[LinkNews, ...] = ()
    """One for each browser."""
    opened: str = ""
    """The older scan that is shown instead of the rig's; empty: the rig's."""


def panel_html(snapshot: Snapshot, now_ns: int, picture: Picture) -> str:
    """State, progress, numbers, faults and what is missing."""
    head = heading(snapshot, now_ns)
    parts = [_heading(head, snapshot), *_faults(snapshot.status)]
    if picture.opened:
        parts.append(_remark(Remark("note", f"The cloud shown is an older scan's: {picture.opened}.")))
    if snapshot.status is not None:
        numbers = _progress(snapshot) + _table(_numbers(snapshot) + _legend(picture))
        parts.append(f'<div class="{"" if head.live else "sw-old"}">{numbers}</div>')
        parts.append(_saved(snapshot.status))
    parts += [_remark(remark) for remark in remarks(snapshot, now_ns, picture.keep_one_of)]
    return f'<div class="sw" {_data(snapshot, head)}>{"".join(parts)}</div>'


def note_html(note: CommandNote, now_ns: int) -> str:
    """What became of the last click; empty when it is long ago."""
    if not note.text or now_ns - note.at_ns > NOTE_SHOWN_NS:
        return ""
    kind, mark = ("", "✓") if note.ok else ("sw-warning", "!")
    return f'<div class="sw"><div class="sw-box {kind}"><span class="mark">{mark}</span>{escape(note.text)}</div></div>'


def beat_html(clock: str, view_only: bool) -> str:
    """A clock that stands still on a dead page, and a warning that shows itself when the clock is not renewed."""
    only = " · view only" if view_only else ""
    return (
        f'<div class="sw"><div class="sw-beat">page alive <b class="num">{escape(clock)}</b>{only}</div>'
        '<div class="sw-dead">This page has lost the viewer: what it shows is old. Reload it.</div></div>'
    )


def _data(snapshot: Snapshot, head: Heading) -> str:
    """What a program wants to read off the page."""
    progress = snapshot.progress
    facts = {
        "live": str(head.live).lower(),
        "state": snapshot.status.state if snapshot.status is not None else "",
        "folded-through": progress.folded_through if progress is not None else -1,
        "cloud-through": snapshot.cloud_folded_through,
    }
    return " ".join(f'data-{name}="{escape(str(value))}"' for name, value in facts.items())


def _heading(head: Heading, snapshot: Snapshot) -> str:
    name = scan_name(snapshot.status) if snapshot.status is not None else ""
    state = (
        f'<div class="sw-state"><span class="glyph">{escape(head.glyph)}</span><span>{escape(head.words)}</span></div>'
    )
    said = snapshot.status.message if snapshot.status is not None else ""
    told = snapshot.status is None or said in ("", saved_line(snapshot.status))
    message = "" if told else f'<div class="sw-said">{escape(said)}</div>'
    return f'{state}<div class="sw-name">{escape(name) or "no scan"}</div>{message}'


def _progress(snapshot: Snapshot) -> str:
    status, progress = snapshot.status, snapshot.progress
    if status is None or not status.expected:
        return ""
    folded = progress.folded_through + 1 if progress is not None and _same_scan(snapshot) else 0
    saved_percent = min(100.0, 100 * status.committed / status.expected)
    folded_percent = min(100.0, 100 * folded / status.expected)
    bars = "".join(f'<i style="width:{percent:.1f}%"></i>' for percent in (saved_percent, folded_percent))
    return f'<div class="sw-bar">{bars}</div>'


def _same_scan(snapshot: Snapshot) -> bool:
    return snapshot.status is not None and snapshot.cloud_scan_uid in ("", snapshot.status.scan_uid)


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
        rows.append((_swatch() + "provisional", f"{progress.points_provisional:,}"))
    if status is not None:
        trust = "" if status.position_trusted else " (not trusted)"
        rows.append(("Stage", f"{status.position_um:,.1f} µm{trust}"))
    return rows


def _flaws(status: Status) -> str:
    missing = f", {status.missing:,} missing" if status.missing else ""
    return missing + (f", {status.retaken:,} taken again" if status.retaken else "")


def _legend(picture: Picture) -> list[tuple[str, str]]:
    rows = [("Floor, z = 0", f"{picture.floor_cell_mm:g} mm cells")] if picture.floor_cell_mm else []
    if picture.links:
        rows.append(("Browsers", _links_words(picture.links)))
    return rows


def _links_words(links: tuple[LinkNews, ...]) -> str:
    sent = format_bytes(sum(link.bytes_per_s for link in links))
    slow = sum(link.slow for link in links)
    return f"{len(links)}, {sent}/s" + (f", {slow} slow: overview first" if slow else "")


def legend_html(legend: Legend | None) -> str:
    """Title, unit, histogram, bar and ticks of the shown quantity; empty for a photograph."""
    if legend is None:
        return ""
    shades = [f"rgb({','.join(map(str, shade))})" for shade in table(legend.map_name)[:: LEVELS // 16].tolist()]
    ticks = [legend.low + (legend.high - legend.low) * part / 4 for part in range(5)]
    bars = "".join(f'<i style="height:{100 * part:.0f}%"></i>' for part in legend.bins)
    clipped = f"{legend.below_percent:.1f} % below, {legend.above_percent:.1f} % above"
    note = f'<div class="sw-beat">{escape(legend.note)}</div>' if legend.note else ""
    return (
        f'<div class="sw sw-legend"><b>{escape(legend.title)}</b>, {escape(legend.unit)}'
        f'<div class="sw-bins">{bars}</div>'
        f'<div class="sw-map" style="background:linear-gradient(to right,{",".join(shades)})"></div>'
        f'<div class="sw-ticks num">{"".join(f"<span>{tick:,.{legend.decimals}f}</span>" for tick in ticks)}</div>'
        f'<div class="sw-beat">{clipped}; provisional points darker</div>{note}</div>'
    )


def _table(rows: list[tuple[str, str]]) -> str:
    cells = "".join(f'<tr><td>{name}</td><td class="num">{escape(value)}</td></tr>' for name, value in rows)
    return f"<table>{cells}</table>"


def _swatch() -> str:
    red, green, blue = PROVISIONAL_RGB
    return f'<span class="sw-swatch" style="background:rgb({red},{green},{blue})"></span>'


def _saved(status: Status) -> str:
    line = saved_line(status)
    if not line:
        return ""
    good = line.startswith("SAVED")
    mark = "✓" if good else "!"
    kind = "sw-saved" if good else "sw-warning"
    return f'<div class="sw-box {kind}"><span class="mark">{mark}</span>{escape(line)}</div>'


def _faults(status: Status | None) -> list[str]:
    return [_fault(fault) for fault in status.faults] if status is not None else []


def _fault(fault: FaultReport) -> str:
    return (
        f'<div class="sw-box sw-fault" role="alert"><span class="mark">✖ {escape(fault.code)}</span>'
        f"{escape(fault.happened)}<br>Safe: {escape(fault.safe)}<br>To do: {escape(fault.to_do)}</div>"
    )


def _remark(remark: Remark) -> str:
    mark = _GLYPHS[remark.level]
    return f'<div class="sw-box sw-{remark.level}"><span class="mark">{mark}</span>{escape(remark.text)}</div>'
