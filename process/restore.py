"""Owns the question whether a scan has its maps already: made of exactly the frames that its file holds now."""

from __future__ import annotations

from acquire.contract.errors import ScanFileError

from .frames import ScanFrames
from .outputs import ResultPaths
from .report import read_report
from .results import read_source


def has_results(frames: ScanFrames) -> bool:
    """True if maps.h5 and report.json beside the scan file are of this scan, all its frames and its outcome."""
    paths = ResultPaths(frames.layout.path.parent)
    try:
        source, report = read_source(paths.maps), read_report(paths.report)
    except ScanFileError:
        return False
    same = source.scan_uid == frames.layout.scan_uid and source.digest == frames.digest()
    return same and report.outcome == frames.outcome
