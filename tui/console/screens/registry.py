"""The class of each screen, imported when it is first needed: the console starts without HDF5 and the calibration."""

from __future__ import annotations

from tui.console.screens.base import RigScreenBase


def screen_class(name: str) -> type[RigScreenBase]:  # noqa: PLR0911 - a table whose imports are late
    """The class of a screen of ``SCREENS``.

    Raises:
        KeyError: there is no such screen.
    """
    match name:
        case "scan":
            from tui.console.screens.scan import ScanScreen  # noqa: PLC0415

            return ScanScreen
        case "reconstruct":
            from tui.console.screens.reconstruct import ReconstructScreen  # noqa: PLC0415

            return ReconstructScreen
        case "calibrate":
            from tui.console.screens.calibrate import CalibrateScreen  # noqa: PLC0415

            return CalibrateScreen
        case "scans":
            from tui.console.screens.scans import ScansScreen  # noqa: PLC0415

            return ScansScreen
        case "faults":
            from tui.console.screens.faults import FaultsScreen  # noqa: PLC0415

            return FaultsScreen
        case "log":
            from tui.console.screens.log import LogScreen  # noqa: PLC0415

            return LogScreen
    raise KeyError(name)
