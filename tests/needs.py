"""What tests need from the system: one check for each Debian package that ``make test`` installs."""

from __future__ import annotations

import ctypes
import importlib
import os
import platform
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from acquire.stages.uno.emulator import missing_tools

LIBPYTHON = f"libpython{sys.version_info[0]}.{sys.version_info[1]}"
"""GenICam's library is linked against it; Debian's Python works without it."""


def _loads(library: str) -> bool:
    try:
        ctypes.CDLL(library)
    except OSError:
        return False
    return True


def _any_font() -> bool:
    folders = (Path("/usr/share/fonts"), Path("/usr/local/share/fonts"))
    return any(path.suffix in (".ttf", ".otf") for folder in folders for path in folder.rglob("*"))


PACKAGES: dict[str, Callable[[], bool]] = {
    "chromium": lambda: chromium_path() is not None,
    "fonts-dejavu-core": _any_font,
    "libegl1": lambda: _loads("libEGL.so.1"),
    "libopengl0": lambda: _loads("libOpenGL.so.0"),
    LIBPYTHON: lambda: _loads(f"{LIBPYTHON}.so.1.0"),
    "libusb-1.0-0": lambda: _loads("libusb-1.0.so.0"),
    "systemd": lambda: shutil.which("systemd-analyze") is not None and Path("/lib/systemd/systemd").exists(),
    "tmux": lambda: shutil.which("tmux") is not None,
    "gcc": lambda: shutil.which("cc") is not None,
    "libc6-dev": lambda: Path("/usr/include/stdlib.h").exists(),
    **{package: lambda package=package: package not in missing_tools() for package in
       ("gcc-avr", "avr-libc", "libsimavr-dev", "libelf-dev")},
}  # fmt: skip
"""Name of a Debian package -> whether what it brings is there."""

OPEN3D = ("libegl1", "libusb-1.0-0")
EMULATOR = ("gcc", "libc6-dev", "gcc-avr", "avr-libc", "libsimavr-dev", "libelf-dev")


def chromium_path() -> str | None:
    """Where a Chromium browser is."""
    return shutil.which("chromium") or shutil.which("chromium-browser")


def need(*packages: str, module: bool = False) -> None:
    """Skip with the reason where the machine lacks one of the packages; in CI that is a failure.

    Args:
        packages: keys of PACKAGES.
        module: called at the top of a test module, which is skipped as a whole.
    """
    missing = [package for package in packages if not PACKAGES[package]()]
    if missing:
        missing_here(f"not installed: {', '.join(missing)} (apt-get install, or make system-packages)", module=module)


def need_genicam(*, module: bool = False) -> None:
    """As :func:`need`, for GenICam's library, which exists for one processor only."""
    if platform.machine() != "x86_64":
        pytest.skip("GenICam's library has no wheel for this processor", allow_module_level=module)
    need(LIBPYTHON, module=module)


def need_module(name: str) -> ModuleType:
    """The Python module ``name``; where it is not installed, as :func:`need`."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        missing_here(f"not installed: {error.name} (make install-test)")
        raise


def missing_here(reason: str, *, module: bool = False) -> None:
    """What a test needs is not to be had: skip it with the reason; in CI fail."""
    if os.environ.get("CI"):
        pytest.fail(f"{reason}; CI must have it")
    pytest.skip(reason, allow_module_level=module)
