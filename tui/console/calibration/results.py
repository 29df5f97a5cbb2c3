"""The result of a calibration in words: passed or failed with the reason, residuals of each view; pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from tui.console.jobs import Job
from tui.scans.folder import ScanEntry

MAX_RMS_PX = 0.3
"""Limit of the reprojection error: beyond it, corners were not located correctly."""
MIN_COVERAGE = 0.4
"""Share of the field that the corners must span."""
MAX_SATURATED = 0.3
"""Share of a sweep's lit pixels beyond which the light plane is not calibrated with it."""
BAR_CELLS = 12


@dataclass(frozen=True)
class CalibrationResult:
    """The result of one step."""

    passed: bool
    headline: str
    """Passed or failed, and why, in one line."""
    lines: tuple[str, ...]
    """Residuals and notes."""


def sweep_words(entry: ScanEntry) -> str:
    """How a sweep over the board ended, and that it is saturated, where its report says so."""
    share = entry.saturated_share
    if share is None or share <= MAX_SATURATED:
        return entry.outcome_words
    return f"{entry.outcome_words}, {100 * share:.0f} % SATURATED: e, then sweep again"


def result_of(job: Job, before: dict[str, Any], *, plane: bool) -> CalibrationResult:
    """The result of a calibration that has ended; ``before`` is the ``camera`` of the calibration before."""
    if not job.ok or job.result is None:
        return CalibrationResult(False, f"FAILED: {job.words or 'no result'}", ())
    found = job.result.get("light_plane" if plane else "camera") or {}
    result = plane_result(found) if plane else camera_result(found, before)
    out = str(job.result.get("out") or "")
    use = f"to use it: reconstruct.calibration = '{out}' in rig.toml" if plane else "next: m goes to the light plane"
    return CalibrationResult(result.passed, result.headline, (use, *result.lines))


def camera_result(camera: dict[str, Any], before: dict[str, Any]) -> CalibrationResult:
    """The ``camera`` object of calibration.json, compared with the ``before`` one (empty: none)."""
    quality = camera.get("quality") or {}
    rms, coverage = _number(quality.get("rms_px")), _number(quality.get("coverage"))
    views = [view for view in quality.get("views") or [] if isinstance(view, dict)]
    used = sum(bool(view.get("used")) for view in views)
    reasons = []
    if rms is None or rms > MAX_RMS_PX:
        reasons.append(f"corners are off by {_px(rms)}, the limit is {MAX_RMS_PX:g} px: sharper pictures, a flat board")
    if coverage is not None and coverage < MIN_COVERAGE:
        reasons.append(f"the views cover only {100 * coverage:.0f} % of the field: move the board about")
    headline = f"reprojection error {_px(rms)} RMS, {used} of {len(views)} views used"
    lines = [_view_line(view, max((_number(v.get("rms_px")) or 0.0 for v in views), default=1.0)) for view in views]
    lines += [f"note: {note}" for note in quality.get("notes") or []]
    lines += _compared(camera, before)
    return _result(reasons, headline, lines)


def plane_result(plane: dict[str, Any]) -> CalibrationResult:
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
    return _result(reasons, f"{len(surfaces)} surfaces{normal}", lines)


def _result(reasons: list[str], headline: str, lines: list[str]) -> CalibrationResult:
    if reasons:
        return CalibrationResult(False, f"FAILED: {reasons[0]}", (*reasons[1:], headline, *lines))
    return CalibrationResult(True, f"PASSED: {headline}", tuple(lines))


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
