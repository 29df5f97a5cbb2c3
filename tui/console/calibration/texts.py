"""What a calibration is worth, in words: passed or failed with the reason, residuals view by view; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tui.processes.child_jobs import Job
from tui.scans.folder import ScanEntry

MOST_RMS_PX = 0.3
"""Reprojection error beyond which corners were not found where they are."""
LEAST_COVERAGE = 0.4
"""Share of the field that the corners must span."""
MOST_SATURATED = 0.3
"""Share of a sweep's lit pixels beyond which the light plane is not calibrated with it."""
BAR_CELLS = 12


@dataclass(frozen=True)
class Verdict:
    """The result of one step."""

    passed: bool
    headline: str
    """Passed or failed, and why, in one line."""
    lines: tuple[str, ...]
    """Residuals and notes."""


def sweep_words(entry: ScanEntry) -> str:
    """How a sweep over the board ended, and why it will not do, where its worker has said so."""
    share = entry.saturated_share
    if share is None or share <= MOST_SATURATED:
        return entry.outcome_words
    return f"{entry.outcome_words}, {100 * share:.0f} % SATURATED: e, then sweep again"


def verdict_of(job: Job, before: dict[str, Any], *, plane: bool) -> Verdict:
    """What a calibration that has ended came to; ``before`` is the ``camera`` of the calibration before."""
    if not job.ok or job.result is None:
        return Verdict(False, f"FAILED: {job.words or 'no result'}", ())
    found = job.result.get("light_plane" if plane else "camera") or {}
    verdict = plane_verdict(found) if plane else camera_verdict(found, before)
    out = str(job.result.get("out") or "")
    use = f"to use it: reconstruct.calibration = '{out}' in rig.toml" if plane else "next: m goes to the light plane"
    return Verdict(verdict.passed, verdict.headline, (use, *verdict.lines))


def camera_verdict(camera: dict[str, Any], before: dict[str, Any]) -> Verdict:
    """The ``camera`` object of calibration.json, compared with the ``before`` one (empty: none)."""
    quality = camera.get("quality") or {}
    rms, coverage = _number(quality.get("rms_px")), _number(quality.get("coverage"))
    views = [view for view in quality.get("views") or [] if isinstance(view, dict)]
    used = sum(bool(view.get("used")) for view in views)
    reasons = []
    if rms is None or rms > MOST_RMS_PX:
        reasons.append(f"corners miss by {_px(rms)}, {MOST_RMS_PX:g} px are the limit: sharper pictures, a flat board")
    if coverage is not None and coverage < LEAST_COVERAGE:
        reasons.append(f"the views cover {100 * coverage:.0f} % of the field only: move the board about")
    headline = f"reprojection error {_px(rms)} RMS, {used} of {len(views)} views used"
    lines = [_view_line(view, max((_number(v.get("rms_px")) or 0.0 for v in views), default=1.0)) for view in views]
    lines += [f"note: {note}" for note in quality.get("notes") or []]
    lines += _compared(camera, before)
    return _verdict(reasons, headline, lines)


def plane_verdict(plane: dict[str, Any]) -> Verdict:
    """The ``light_plane`` object of calibration.json."""
    quality = plane.get("quality") or {}
    surfaces = [surface for surface in quality.get("surfaces") or [] if isinstance(surface, dict)]
    reasons = [f"{s.get('name')}: {s.get('cause')}" for s in surfaces if not s.get("ok", True)]
    lines = [
        f"{_short(str(s.get('name')))}  mean {_um(s.get('mean_um'), '+')}  RMS {_um(s.get('rms_um'))}  "
        f"trend {_um(s.get('slope_um'))}  {'ok' if s.get('ok', True) else 'FAILED'}"
        for s in surfaces
    ]
    lines += [f"note: {note}" for note in quality.get("notes") or []]
    sd = _number(quality.get("normal_sd_deg"))
    normal = "" if sd is None else f", normal known to {sd:.4f} degrees"
    return _verdict(reasons, f"{len(surfaces)} surfaces{normal}", lines)


def _verdict(reasons: list[str], headline: str, lines: list[str]) -> Verdict:
    if reasons:
        return Verdict(False, f"FAILED: {reasons[0]}", (*reasons[1:], headline, *lines))
    return Verdict(True, f"PASSED: {headline}", tuple(lines))


def _view_line(view: dict[str, Any], worst: float) -> str:
    rms, name = _number(view.get("rms_px")), str(view.get("name")).removesuffix(".png")
    if rms is None or not view.get("used"):
        return f"{name}  left out: {view.get('reason') or 'no reason'}"
    cells = max(1, round(BAR_CELLS * rms / worst)) if worst > 0 else 1
    return f"{name}  {rms:.4f} px  {'=' * cells}"


def _short(name: str) -> str:
    """A scan folder's name without its time."""
    stamp, _, rest = name.partition("Z-")
    return rest if len(stamp) == 15 and rest else name


def _compared(camera: dict[str, Any], before: dict[str, Any]) -> list[str]:
    try:
        now, then = float(camera["K"][0][0]), float(before["K"][0][0])
        near, far = float(camera["T"][2]), float(before["T"][2])
    except (KeyError, IndexError, TypeError, ValueError):
        return []
    change = 100 * (now / then - 1) if then else 0.0
    return [f"the calibration before: focal length {change:+.2f} %, distance {near - far:+.3f} mm"]


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None


def _px(value: float | None) -> str:
    return "an unknown distance" if value is None else f"{value:.4f} px"


def _um(value: Any, sign: str = "") -> str:
    number = _number(value)
    return "?" if number is None else f"{number:{sign}.2f} um"
