"""Paths of an installation, for the whole machine or for one user."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from acquire.contract.config.load import home_resolved


@dataclass(frozen=True)
class InstallPaths:
    """Absolute paths of one installation."""

    home: Path
    """The program: ``releases/<stamp>`` are environments, ``current`` is a link to one of them."""
    units: Path
    """Folder of systemd's unit files."""
    config: Path
    """rig.toml."""
    data: Path
    """Folder of all scans in a new configuration; neither an update nor uninstalling touches it."""
    command: Path
    """Link to the command, in a folder of the search path."""
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
        """JSON list of the files installed outside of :attr:`home`."""
        return self.home / "installed.json"

    def system_files(self) -> dict[str, Path]:
        """Files below ``systemd`` of the source tree that only the machine gets, and where they go."""
        if self.user:
            return {}
        return {
            "sysusers.d/sweepscope.conf": Path("/usr/lib/sysusers.d/sweepscope.conf"),
            "tmpfiles.d/sweepscope.conf": Path("/usr/lib/tmpfiles.d/sweepscope.conf"),
            "udev/70-sweepscope.rules": Path("/etc/udev/rules.d/70-sweepscope.rules"),
        }


def machine_paths() -> InstallPaths:
    """For the whole machine."""
    return InstallPaths(
        home=Path("/opt/sweepscope"),
        units=Path("/etc/systemd/system"),
        config=Path("/etc/sweepscope/rig.toml"),
        data=Path("/var/lib/sweepscope/scans"),
        command=Path("/usr/local/bin/sweepscope"),
        cache=Path("/var/cache/sweepscope"),
    )


def user_paths(environ: Mapping[str, str] = os.environ) -> InstallPaths:
    """For the user of this process."""
    home = Path(environ.get("HOME") or home_resolved("~", "HOME"))
    config = Path(environ.get("XDG_CONFIG_HOME") or home / ".config")
    share = Path(environ.get("XDG_DATA_HOME") or home / ".local/share")
    return InstallPaths(
        home=share / "sweepscope",
        units=config / "systemd/user",
        config=config / "sweepscope/rig.toml",
        data=home / "sweepscope-scans",
        command=home / ".local/bin/sweepscope",
        cache=Path(environ.get("XDG_CACHE_HOME") or home / ".cache") / "sweepscope",
        user=True,
    )
