"""Owns where an installation puts things, for the whole machine or for one user."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

UNIT_PROGRAM = "/opt/sweepscope/current/bin/sweepscope"
"""The program as it stands in the unit files of this project."""
TARGET = "sweepscope.target"
SERVICES = ("daemon", "writer", "worker", "viewer")
MANIFEST = "installed.json"


@dataclass(frozen=True)
class Places:
    """Absolute paths of one installation."""

    home: Path
    """The program: ``releases/<stamp>`` environments, ``current`` points to one of them."""
    units: Path
    config: Path
    """rig.toml."""
    data: Path
    """Folder of all scans that a new configuration names; never touched by an update or by uninstalling."""
    command: Path
    """Link that puts the command onto everybody's path."""
    cache: Path
    user: bool = False
    """For one user: no group, no device rules, units of the user's own systemd."""

    @property
    def current(self) -> Path:
        """Link to the release that runs."""
        return self.home / "current"

    @property
    def releases(self) -> Path:
        """Folder of environments."""
        return self.home / "releases"

    @property
    def manifest(self) -> Path:
        """List of the files that were put outside of :attr:`home`."""
        return self.home / MANIFEST

    def system_files(self) -> dict[str, Path]:
        """Files of the source tree's ``systemd`` folder for the whole machine, and where they go."""
        if self.user:
            return {}
        return {
            "sysusers.d/sweepscope.conf": Path("/usr/lib/sysusers.d/sweepscope.conf"),
            "tmpfiles.d/sweepscope.conf": Path("/usr/lib/tmpfiles.d/sweepscope.conf"),
            "udev/70-sweepscope.rules": Path("/etc/udev/rules.d/70-sweepscope.rules"),
        }


def machine_places() -> Places:
    """For the whole machine."""
    return Places(
        home=Path("/opt/sweepscope"),
        units=Path("/etc/systemd/system"),
        config=Path("/etc/sweepscope/rig.toml"),
        data=Path("/var/lib/sweepscope/scans"),
        command=Path("/usr/local/bin/sweepscope"),
        cache=Path("/var/cache/sweepscope"),
    )


def user_places(environ: Mapping[str, str] = os.environ) -> Places:
    """For the user that runs us."""
    home = Path(environ.get("HOME") or Path.home())
    config = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
    share = Path(environ.get("XDG_DATA_HOME") or home / ".local/share")
    return Places(
        home=share / "sweepscope",
        units=config / "systemd/user",
        config=config / "sweepscope/rig.toml",
        data=home / "sweepscope-scans",
        command=home / ".local/bin/sweepscope",
        cache=Path(environ.get("XDG_CACHE_HOME") or home / ".cache") / "sweepscope",
        user=True,
    )
