"""Owns uninstalling: takes away everything that installing put there, and leaves scans and their configuration."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from acquire.contract.config.load import load_config
from acquire.contract.errors import ConfigError
from tui.install.install import OWNER
from tui.install.machine import InstallError, run, systemctl, systemd_runs
from tui.install.paths import TARGET, Places
from tui.install.services import refuse_during_a_sweep


def uninstall_steps(places: Places, say: Callable[[str], None]) -> list[tuple[str, Callable[[], None]]]:
    """Words and deeds in their order; each may be done again.

    Raises:
        InstallError: nothing is installed there.
    """
    if not places.manifest.exists():
        raise InstallError(f"nothing is installed in {places.home}")
    data = _data_dir(places)
    steps: list[tuple[str, Callable[[], None]]] = []
    steps.append(("see that no sweep is running", lambda: refuse_during_a_sweep(places)))
    if systemd_runs(user=places.user):
        steps.append((f"stop and disable {TARGET}", lambda: _stop(places)))
    steps.append(("keep the configuration beside the scans", lambda: _keep_config(places, data, say)))
    steps.append(("remove units, rules and links", lambda: _remove_files(places)))
    if not places.user:
        steps.append(("give the scans to root and remove user and group", lambda: _remove_user(data, say)))
    steps.append((f"remove {places.home} and {places.cache}", lambda: _remove_program(places)))
    return steps


def _stop(places: Places) -> None:
    with suppress(InstallError):  # a target that was never enabled
        systemctl("disable", "--quiet", TARGET, user=places.user)
    systemctl("stop", TARGET, "sweepscope-*.service", user=places.user)


def _data_dir(places: Places) -> Path:
    try:
        return load_config(str(places.config), environ={}).data_dir
    except ConfigError:
        return places.data


def _keep_config(places: Places, data: Path, say: Callable[[str], None]) -> None:
    if places.config.exists() and data.is_dir():
        shutil.copyfile(places.config, data / "rig.toml")
        say(f"  {data / 'rig.toml'}")


def _remove_files(places: Places) -> None:
    for name in json.loads(places.manifest.read_text())["files"]:
        Path(name).unlink(missing_ok=True)
    for drop_in in places.units.glob("sweepscope*.d"):  # made by 'systemctl edit'
        shutil.rmtree(drop_in, ignore_errors=True)
    places.config.unlink(missing_ok=True)
    if places.user:
        with suppress(OSError):  # a person's own key stays: it opens other rigs too
            places.config.parent.rmdir()
    else:
        for folder in (places.config.parent, Path("/run/sweepscope")):
            shutil.rmtree(folder, ignore_errors=True)
    if systemd_runs(user=places.user):
        systemctl("daemon-reload", user=places.user)


def _remove_user(data: Path, say: Callable[[str], None]) -> None:
    for path in (Path("/var/lib/sweepscope"), data, *data.rglob("*")):
        with suppress(OSError, LookupError):
            if path.owner() == OWNER:  # scans that belong to somebody else stay theirs
                os.chown(path, 0, 0, follow_symlinks=False)
    for command in (("userdel", OWNER), ("groupdel", OWNER)):
        try:
            run(*command, timeout_s=30)
        except InstallError as error:
            if "does not exist" not in str(error):
                say(f"  {error}")


def _remove_program(places: Places) -> None:
    if not places.user:
        for path in Path("/var/lib/sweepscope").glob(".*"):  # what libraries leave in a home; never scans
            shutil.rmtree(path, ignore_errors=True)
    for folder in (places.cache, places.home):
        shutil.rmtree(folder, ignore_errors=True)
