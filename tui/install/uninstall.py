"""Uninstalls: removes everything that installing created, except scans and their configuration."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from acquire.contract.config.load import load_config
from acquire.contract.errors import ConfigError
from tui.install.install import OWNER, Step
from tui.install.machine import InstallError, run
from tui.install.paths import InstallPaths
from tui.install.systemd import ALL_SERVICES, TARGET, refuse_during_a_sweep, systemctl, systemd_runs


def uninstall_steps(paths: InstallPaths, say: Callable[[str], None]) -> list[Step]:
    """The steps in order; each may be repeated.

    Raises:
        InstallError: nothing is installed there.
    """
    if not paths.manifest.exists():
        raise InstallError(f"nothing is installed in {paths.home}")
    data = _data_dir(paths)
    steps: list[Step] = [("check that no sweep is running", lambda: refuse_during_a_sweep(paths))]
    if systemd_runs(user=paths.user):
        steps.append((f"stop and disable {TARGET}", lambda: _stop(paths)))
    steps.append(("copy the configuration next to the scans", lambda: _keep_config(paths, data, say)))
    steps.append(("remove units, rules and links", lambda: _remove_files(paths)))
    if not paths.user:
        steps.append(("give the scans to root and remove user and group", lambda: _remove_user(data, say)))
    steps.append((f"remove {paths.home} and {paths.cache}", lambda: _remove_program(paths)))
    return steps


def _stop(paths: InstallPaths) -> None:
    with suppress(InstallError):  # the target was never enabled
        systemctl("disable", "--quiet", TARGET, user=paths.user)
    systemctl("stop", TARGET, ALL_SERVICES, user=paths.user)


def _data_dir(paths: InstallPaths) -> Path:
    try:
        return load_config(str(paths.config), environ={}).data_dir
    except ConfigError:
        return paths.data


def _keep_config(paths: InstallPaths, data: Path, say: Callable[[str], None]) -> None:
    if paths.config.exists() and data.is_dir():
        shutil.copyfile(paths.config, data / "rig.toml")
        say(f"  {data / 'rig.toml'}")


def _remove_files(paths: InstallPaths) -> None:
    for name in json.loads(paths.manifest.read_text())["files"]:
        Path(name).unlink(missing_ok=True)
    for drop_in in paths.units.glob("sweepscope*.d"):  # ours, and those made by 'systemctl edit'
        shutil.rmtree(drop_in, ignore_errors=True)
    paths.config.unlink(missing_ok=True)
    if paths.user:
        with suppress(OSError):  # not empty: the user's own key stays, because it opens other rigs too
            paths.config.parent.rmdir()
    else:
        for folder in (paths.config.parent, Path("/run/sweepscope")):
            shutil.rmtree(folder, ignore_errors=True)
    if systemd_runs(user=paths.user):
        systemctl("daemon-reload", user=paths.user)


def _remove_user(data: Path, say: Callable[[str], None]) -> None:
    for path in (Path("/var/lib/sweepscope"), data, *data.rglob("*")):
        with suppress(OSError, LookupError):
            if path.owner() == OWNER:  # scans of other users stay theirs
                os.chown(path, 0, 0, follow_symlinks=False)
    for command in (("userdel", OWNER), ("groupdel", OWNER)):
        try:
            run(*command, timeout_s=30)
        except InstallError as error:
            if "does not exist" not in str(error):
                say(f"  {error}")


def _remove_program(paths: InstallPaths) -> None:
    if not paths.user:
        for path in Path("/var/lib/sweepscope").glob(".*"):  # hidden files of libraries; never scans
            shutil.rmtree(path, ignore_errors=True)
    for folder in (paths.cache, paths.home):
        shutil.rmtree(folder, ignore_errors=True)
