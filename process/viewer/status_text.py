"""What the page says about the state of the rig: plain words with a sign, never colour alone. Pure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from acquire.contract.messaging.messages import Status
from acquire.contract.permissions import PERMISSIONS, why_not_offered
from acquire.contract.states import RUNNING_STATES, Outcome, State, outcome_words, sign_of
from acquire.contract.units import NS_PER_S, format_duration
from process.viewer.rig_client.feed import Peer, Snapshot

SILENT_NS = 2 * NS_PER_S
"""The daemon sends five statuses a second; after so long without one the page says so."""
WORKER_SILENT_NS = 5 * NS_PER_S
WORKER_LAG_FRAMES = 2

Level = Literal["note", "warning", "fault"]

WORDS: dict[str, str] = {
    State.DISCONNECTED: "stage or camera not connected",
    State.IDLE: "ready",
}
"""States that the page calls by another word than the rig does."""


@dataclass(frozen=True)
class Heading:
    """The state in a glyph and words."""

    glyph: str
    words: str
    live: bool
    """False: what stands below is old."""


@dataclass(frozen=True)
class Remark:
    """Something that is missing or not as it should be."""

    level: Level
    text: str


def heading(snapshot: Snapshot, now_ns: int) -> Heading:
    """The state of the rig, or why it is not known."""
    daemon, status = snapshot.daemon, snapshot.status
    if not daemon.connected:
        return Heading("◌", "not connected – retrying", live=False)
    if status is None:
        return Heading("◌", "connected, waiting for the first status", live=False)
    if now_ns - daemon.heard_ns > SILENT_NS:
        return Heading("◌", f"no status from the rig for {_seconds(now_ns - daemon.heard_ns)}", live=False)
    words = WORDS.get(status.state, status.state)
    if status.state == State.HOLDING and status.hold_reason:
        words = f"holding: {status.hold_reason}"
    return Heading(sign_of(status.state).glyph, words, live=True)


def remarks(snapshot: Snapshot, now_ns: int, thinned_to_one_of: int = 1) -> list[Remark]:
    """What is missing, most important first; an empty list when all is well."""
    found = [*_about_daemon(snapshot, now_ns), *_about_worker(snapshot, now_ns), *_about_cloud(snapshot)]
    if thinned_to_one_of > 1:
        found.append(Remark("note", f"Showing 1 of {thinned_to_one_of} points, spread evenly (viewer.max_points)."))
    if snapshot.points_left_out:
        found.append(Remark("warning", f"{snapshot.points_left_out} points were not finite and are left out."))
    if snapshot.messages_dropped:
        text = f"{snapshot.messages_dropped} messages could not be read: restart all services with the same version."
        found.append(Remark("warning", text))
    return found


def _about_daemon(snapshot: Snapshot, now_ns: int) -> list[Remark]:
    daemon, status = snapshot.daemon, snapshot.status
    if not daemon.connected and status is None:
        return [Remark("warning", "No rig daemon: start it with “sweepscope up”. This page connects by itself.")]
    if not daemon.connected:
        since = _away(daemon, now_ns)
        return [Remark("warning", f"The rig daemon has been away{since}; these numbers are the last that it sent.")]
    if status is not None and not status.scan_path and not snapshot.cloud_scan_uid:
        return [Remark("note", "No scan yet.")]
    if status is not None and not status.writer_alive and status.state in RUNNING_STATES:
        return [Remark("warning", "The writer is away: no frame is triggered until it is back. Nothing is lost.")]
    return []


def _about_worker(snapshot: Snapshot, now_ns: int) -> list[Remark]:
    worker, status, progress = snapshot.worker, snapshot.status, snapshot.progress
    if not worker.connected:
        text = f"No worker{_away(worker, now_ns)}: the cloud does not grow. A sweep goes on without it."
        return [Remark("warning", text)]
    found = []
    if status is not None and status.state == State.SWEEPING and now_ns - worker.heard_ns > WORKER_SILENT_NS:
        behind = status.committed - 1 - (progress.folded_through if progress is not None else -1)
        if behind > WORKER_LAG_FRAMES:
            since = f" for {_seconds(now_ns - worker.heard_ns)}" if worker.heard_ns else ""
            found.append(Remark("warning", f"No message from the worker{since}; the cloud is {behind} frames behind."))
    if progress is not None and progress.message and status is not None and status.scan_path:
        level: Level = "warning" if progress.failed else "note"
        found.append(Remark(level, f"{'No cloud' if progress.failed else 'Worker'}: {progress.message}"))
    return found


def _about_cloud(snapshot: Snapshot) -> list[Remark]:
    status, progress, end = snapshot.status, snapshot.progress, snapshot.end
    if status is not None and status.scan_uid and snapshot.cloud_scan_uid not in ("", status.scan_uid):
        return [Remark("note", "The cloud is that of the scan before; the new one has no points yet.")]
    if end is not None and end.message:
        return [Remark("note", f"Worker: {end.message}")]
    if progress is not None and not progress.message and progress.folded_through >= 0 and not _points(snapshot):
        return [Remark("note", "No points yet: no pixel has passed the contrast and its light edge.")]
    return []


def _points(snapshot: Snapshot) -> int:
    progress = snapshot.progress
    return progress.points_settled + progress.points_provisional if progress is not None else 0


def _away(peer: Peer, now_ns: int) -> str:
    return f" for {_seconds(now_ns - peer.changed_ns)}" if peer.changed_ns else ""


def _seconds(duration_ns: int) -> str:
    whole_s = max(0, duration_ns) // NS_PER_S
    return f"{whole_s} s" if whole_s < 120 else format_duration(whole_s)


def scan_name(status: Status) -> str:
    """The scan's name without the stamp of its folder; empty where there is no scan."""
    folder = Path(status.scan_path).name
    stamp, dash, name = folder.partition("-")
    return name if dash and len(stamp) == 16 and stamp.endswith("Z") else folder


def saved_line(status: Status) -> str:
    """What is safe, once a scan has ended; SAVED only for a complete one with nothing missing, else empty or why."""
    if status.outcome in ("", Outcome.RUNNING):
        return ""
    if status.outcome == Outcome.COMPLETE and (status.missing or status.committed != status.expected):
        return f"ended, but not whole: {status.committed} of {status.expected} frames are safe"
    return outcome_words(status.outcome, status.committed, status.expected)


def allowed(status: Status | None, *, live: bool) -> dict[str, bool]:
    """Which commands are offered now; ``stop`` always is."""
    known = status if live else None
    offered = {name: known is not None and not why_not_offered(name, known) for name in PERMISSIONS}
    return offered | {"stop": True}
