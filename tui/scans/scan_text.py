"""Texts of the scans screen: the results of jobs, and why an action is not possible now."""

from __future__ import annotations

from typing import Any

from acquire.contract.states import Outcome
from tui.scans.folder import ScanEntry


def verify_words(result: dict[str, Any]) -> str:
    """Text for the result of 'sweepscope verify --json'."""
    if result.get("ok"):
        return f"{result.get('committed')} of {result.get('expected')} frames are there, all checksums fit"
    return "; ".join(str(problem) for problem in result.get("problems", ())) or "not valid"


def reconstruct_words(result: dict[str, Any]) -> str:
    """Text for the result of 'sweepscope reconstruct --json'."""
    points = result.get("points")
    made = "maps, no cloud" if points is None else f"{points} points"
    notes = "; ".join(str(warning) for warning in result.get("warnings", ()))
    return made + (f" ({notes})" if notes else "")


def recover_words(result: dict[str, Any]) -> str:
    """Text for the result of 'sweepscope recover --json'."""
    found = result.get("scans") or []
    if not found:
        return "there was nothing to recover"
    scan = found[0]
    words = f"{scan.get('state')}, {scan.get('committed')} of {scan.get('expected')} frames are safe"
    return words + (f" ({scan['detail']})" if scan.get("detail") else "")


def copy_words(result: dict[str, Any]) -> str:
    """Text for the result of 'sweepscope copy --json'."""
    return f"in {result.get('to')}, {result.get('files')} files verified by checksum"


def why_not_now(action: str, entry: ScanEntry, work: str) -> str:
    """Why the scans screen cannot do ``action`` with a scan now; empty if it can.

    ``work`` is what works on the scan (``verify``), empty for nothing.
    """
    if action == "cancel":
        return "" if work else "nothing works on this scan"
    if entry.state == "running":
        return "a sweep runs into this scan"
    if work and action != "open":
        return f"{work} works on it: wait, or x cancels"
    return _why_not_in_state(action, entry)


def _why_not_in_state(action: str, entry: ScanEntry) -> str:
    if action == "open":
        return "" if entry.has_maps else "it has no maps yet: m makes them"
    if action == "seal" and entry.state != "interrupted":
        return "only an interrupted scan can be closed for good"
    if action == "resume" and entry.state != "interrupted" and entry.outcome != Outcome.STOPPED:
        return "only an interrupted or stopped scan can be resumed"
    if action == "recover" and entry.state == "sealed":
        return "it is sealed: there is nothing to recover"
    if entry.state == "unreadable" and action not in ("recover", "trash"):
        return "it cannot be read"
    return ""
