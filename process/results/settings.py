"""How a scan is reconstructed: flag > what the scan recorded > calibration > default; contradictions are refused."""

from __future__ import annotations

import hashlib
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import msgspec

from acquire.contract.calibration import (
    Calibration,
    PerFramePlanes,
    TranslatingPlane,
    check_size,
    check_validity,
    load_calibration,
    parse_calibration,
)
from acquire.contract.config.model import ReconstructConfig
from acquire.contract.errors import CalibrationError, ConfigError, ScanFileError
from acquire.contract.messaging.messages import FrameFormat
from acquire.contract.plan import SweepPlan
from acquire.contract.scan_data.file_layout import ScanLayout

Edge = Literal["rising", "falling"]
Method = Literal["linear", "probit", "fit", "auto"]


@dataclass(frozen=True)
class ReconstructOptions:
    """Settings given by the user; None leaves one to the scan, the calibration, the default."""

    calibration: Path | None = None
    contrast: int | None = None
    """Counts of 8 bit."""
    edge: Edge | None = None
    median: int | None = None
    """Side of the median filter in pixels, odd; 0 for none."""
    method: str | None = None
    out: Path | None = None
    """Folder for the results; None: beside the .h5."""
    force: bool = False
    """Use a calibration although something contradicts it."""


@dataclass(frozen=True)
class Recorded:
    """What a scan recorded of itself, in its file or in its start message."""

    format: FrameFormat
    plan: SweepPlan | None = None
    config_toml: str = ""
    calibration_json: str = ""
    zero_id: str = ""


def recorded_in(layout: ScanLayout) -> Recorded:
    """What a scan file recorded.

    Raises:
        ScanFileError: the recorded configuration or calibration is no text.
    """
    try:
        config, calibration = (layout.verbatim[key].decode("utf-8") for key in ("config", "calibration"))
    except UnicodeDecodeError:
        raise ScanFileError(f"{layout.path}: the recorded configuration or calibration is damaged") from None
    return Recorded(layout.format, layout.plan, config, calibration, layout.zero_id)


@dataclass(frozen=True)
class Settings:
    """Everything the fold and the geometry need to know."""

    contrast: int
    """Least brightness range in counts of 8 bit."""
    median: int
    edge: Edge
    method: Method
    noise_counts: float
    """Standard deviation of a pixel's noise in counts of 8 bit."""
    calibration: Calibration | None
    warnings: tuple[str, ...] = ()
    calibration_source: str = ""
    """``the scan``, or the name of the file given instead; empty without one."""
    calibration_sha256: str = ""
    """Of its text."""
    edge_is_known: bool = True
    """False: nobody said which edge it is; the default was taken."""

    @property
    def live_method(self) -> Literal["linear", "probit"]:
        """Estimate while the sweep runs: from two samples, which the fold holds."""
        return "linear" if self.method == "linear" else "probit"

    @property
    def light_plane(self) -> TranslatingPlane | PerFramePlanes | None:
        """None: maps can be made, a cloud cannot."""
        return self.calibration.light_plane if self.calibration else None

    @property
    def what_is_missing(self) -> str:
        """Why there is no cloud, for the user; empty if there can be one."""
        if self.calibration is None:
            return "no calibration: maps only, no cloud; give one with --calibration"
        return "" if self.light_plane else "the calibration has no light plane: maps only, no cloud"


def settle(recorded: Recorded, options: ReconstructOptions) -> Settings:
    """The settings for one scan.

    Raises:
        CalibrationError: malformed, another image size, another sweep's frame numbers, an edge that contradicts it.
        ConfigError: a flag out of bounds.
        ScanFileError: the recorded configuration cannot be read.
    """
    calibration, source, text = _calibration(recorded, options)
    warnings = _check(calibration, recorded, options) if calibration else []
    plane = calibration.light_plane if calibration else None
    edge = _edge(options, plane)
    if options.edge and plane and options.edge != plane.edge:
        warnings.append(f"edge {options.edge} although the light plane was calibrated with the {plane.edge} edge")
    values = {"method": plane.method} if plane else {}
    values |= _recorded_values(recorded.config_toml)
    values |= {key: value for key in _FLAGS if (value := getattr(options, key)) is not None}
    checked = _checked(values)
    if plane and plane.method != checked.method:
        warnings.append(
            f"the light plane was calibrated with the estimate {plane.method}, the points are made with "
            f"{checked.method}: calibrate with the same one, or reconstruct with --method {plane.method}"
        )
    return Settings(
        contrast=checked.contrast,
        median=checked.median,
        edge=edge,
        method=checked.method,
        noise_counts=checked.noise_counts,
        calibration=calibration,
        warnings=tuple(warnings),
        calibration_source=source,
        calibration_sha256=hashlib.sha256(text.encode()).hexdigest() if calibration else "",
        edge_is_known=options.edge is not None or plane is not None,
    )


METHODS = ("linear", "probit", "fit", "auto")
_FLAGS = ("contrast", "median", "method")


def _calibration(recorded: Recorded, options: ReconstructOptions) -> tuple[Calibration | None, str, str]:
    """The calibration, where it is from, and its text."""
    if options.calibration is not None:
        found, text = load_calibration(options.calibration)
        return found, options.calibration.name, text
    text = recorded.calibration_json
    if text.strip() in ("", "{}"):
        return None, "", ""
    return parse_calibration(text, "the calibration recorded in the scan"), "the scan", text


def _check(calibration: Calibration, recorded: Recorded, options: ReconstructOptions) -> list[str]:
    check_size(calibration, recorded.format.width, recorded.format.height)
    try:
        return check_validity(calibration, recorded.plan, recorded.zero_id)
    except CalibrationError as error:
        if not options.force:
            raise CalibrationError(f"{error}, or insist with --force") from None
        return [f"forced: {error}"]


def _edge(options: ReconstructOptions, plane: TranslatingPlane | PerFramePlanes | None) -> Edge:
    if plane is None:
        return options.edge or "rising"
    if options.edge and options.edge != plane.edge and not options.force:
        raise CalibrationError(
            f"--edge {options.edge} contradicts the calibration, whose light plane is that of the {plane.edge} edge: "
            "leave --edge out, or insist with --force"
        )
    return options.edge or plane.edge


def _recorded_values(config_toml: str) -> dict[str, Any]:
    """The recorded [reconstruct] keys that this version knows."""
    try:
        section = tomllib.loads(config_toml).get("reconstruct", {})
    except tomllib.TOMLDecodeError as error:
        raise ScanFileError(f"the configuration recorded in the scan cannot be read: {error}") from None
    known = set(ReconstructConfig.__struct_fields__) - {"calibration"}
    return {key: value for key, value in section.items() if key in known} if isinstance(section, dict) else {}


def _checked(values: dict[str, Any]) -> ReconstructConfig:
    if values.get("method", "linear") not in METHODS:
        raise ConfigError(f"method {str(values['method'])[:40]!r} is not known: this version has {', '.join(METHODS)}")
    try:
        checked = msgspec.convert(values, ReconstructConfig, strict=True)
    except msgspec.ValidationError as error:
        what, _, where = str(error).partition(" - at `$.")
        raise ConfigError(f"{where.rstrip('`') or 'reconstruct'}: {what}; it is {_value(values, where)}") from None
    if checked.median and checked.median % 2 == 0:
        raise ConfigError(f"median must be odd, or 0 for none; it is {checked.median}")
    return checked


def _value(values: dict[str, Any], where: str) -> str:
    return repr(values.get(where.rstrip("`")))[:40]
