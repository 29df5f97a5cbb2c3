"""Errors for operators: one line that says what happened, what is safe and what to do."""

from __future__ import annotations

EXIT_FAILED = 1
EXIT_USAGE = 2
EXIT_NO_SERVICE = 3
EXIT_INCOMPLETE = 4


class SweepscopeError(Exception):
    """An error that the operator is shown: the text is one line, the exit status is part of the type."""

    exit_status = EXIT_FAILED


class ConfigError(SweepscopeError):
    """A configuration file, environment variable or flag that cannot be used."""


class CalibrationError(SweepscopeError):
    """A calibration that is missing, malformed, or does not fit the scan."""


class ScanFileError(SweepscopeError):
    """A scan file that is missing, damaged, of another layout, or already there."""


class ProtocolError(SweepscopeError):
    """A message that is malformed, out of bounds, or of another major version."""


class AlreadyRunningError(SweepscopeError):
    """Another process holds the lock of this service or scan; the text names its pid."""


class NoServiceError(SweepscopeError):
    """No service answers where one was expected."""

    exit_status = EXIT_NO_SERVICE


class CommandRefusedError(SweepscopeError):
    """The daemon understood the command and refused it; the text says why."""
