"""Installs and updates: builds the new release next to the old one, and goes back to the old one if a step fails."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w

from acquire.contract.config.load import load_config
from acquire.contract.errors import SweepscopeError
from tui.install.machine import InstallError, point, put, run
from tui.install.paths import InstallPaths
from tui.install.systemd import ALL_SERVICES, TARGET, refuse_during_a_sweep, restart, systemctl, systemd_runs, unit_text

OWNER = "sweepscope"
"""User and group of the services."""
Step = tuple[str, Callable[[], Any]]
"""Description of a step, and the function that does it."""


@dataclass(frozen=True)
class InstallOptions:
    """What the user asked for."""

    source: Path
    """Tree with pyproject.toml, constraints.txt and systemd/."""
    settings: dict[str, dict[str, Any]]
    """rig.toml of a first installation; an update keeps the existing configuration."""
    packages_from: Path | None = None
    """site-packages of another environment to share instead of downloading the dependencies."""
    start: bool = True
    """Start the services."""


@dataclass
class Installer:
    """One installation. :meth:`steps` lists what will be done; :meth:`go` does it, and rolls back if a step fails."""

    paths: InstallPaths
    options: InstallOptions
    say: Callable[[str], None]
    stamp: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y%m%d-%H%M%S-%f"))
    _replaced: dict[Path, str | None] = field(default_factory=dict)
    """Text of each changed file before the change; None: there was none."""

    @property
    def release(self) -> Path:
        """The new environment."""
        return self.paths.releases / self.stamp

    def steps(self) -> list[Step]:
        """The steps in order; before the switch nothing that runs is changed."""
        config = self.paths.config
        found: list[Step] = [
            ("check that no sweep is running", lambda: refuse_during_a_sweep(self.paths)),
            (f"build a Python environment in {self.release}", self._build),
            ("try the new program", self._try),
            (f"{'keep' if config.exists() else 'write'} the configuration {config}", self._configure),
        ]
        if not self.paths.user:
            found.append(("create user and group, folders and device rules", self._prepare_machine))
        found.append((f"put units into {self.paths.units}, link {self.paths.command} and switch", self._switch))
        if self._uses_systemd():
            found.append((f"start {TARGET} and wait until all services are ready", self._start))
        return found

    def go(self) -> None:
        """Do all steps.

        Raises:
            InstallError: a step failed; the old release runs as before.
        """
        before = self._current()
        for text, action in self.steps():
            self.say(text)
            try:
                action()
            except BaseException as error:
                self._roll_back(before)
                if not isinstance(error, (SweepscopeError, OSError, KeyboardInterrupt)):
                    raise
                kept = f"{before.name} is in place as before" if before else "nothing is installed"
                raise InstallError(f"{text}: {str(error) or 'interrupted'}; {kept}") from None
        self._remove_old_releases(before)

    def _current(self) -> Path | None:
        return self.paths.current.resolve() if self.paths.current.is_symlink() else None

    def _uses_systemd(self) -> bool:
        return self.options.start and systemd_runs(user=self.paths.user)

    # ---- before the switch ----

    def _build(self) -> None:
        self.paths.releases.mkdir(parents=True, exist_ok=True)
        self.paths.home.chmod(0o755)
        # our own pip installs into it: Debian's Python has none
        run(base_python(user=self.paths.user), "-m", "venv", "--without-pip", self.release)
        python, constraints = self.release / "bin/python", self.options.source / "constraints.txt"
        pip = (sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--disable-pip-version-check")
        if self.options.packages_from is None:
            run(*pip, "--constraint", constraints, self.options.source)
            return
        run(*pip, "--no-deps", self.options.source)
        site = next((self.release / "lib").glob("python3*/site-packages"))
        (site / "shared.pth").write_text(f"{self.options.packages_from}\n")

    def _try(self) -> None:
        run(self.release / "bin/sweepscope", "version", timeout_s=60)

    def _configure(self) -> None:
        if not self.paths.config.exists():
            self._put(self.paths.config, tomli_w.dumps(self.options.settings))
        load_config(str(self.paths.config), environ={})  # one that the new release cannot read fails here

    def _prepare_machine(self) -> None:
        files = self.paths.system_files()
        for name, target in files.items():
            self._put(target, (self.options.source / "systemd" / name).read_text())
        run("systemd-sysusers", files["sysusers.d/sweepscope.conf"])
        run("systemd-tmpfiles", "--create", files["tmpfiles.d/sweepscope.conf"])
        data = self._data_dir()
        if not data.exists():
            data.mkdir(parents=True, mode=0o750)
            shutil.chown(data, OWNER, OWNER)
        if systemd_runs(user=False) and shutil.which("udevadm") and Path("/run/udev/control").exists():
            run("udevadm", "control", "--reload", timeout_s=30)
            run("udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=video4linux", timeout_s=30)

    def _data_dir(self) -> Path:
        return load_config(str(self.paths.config), environ={}).data_dir

    # ---- the switch and after ----

    def _switch(self) -> None:
        refuse_during_a_sweep(self.paths)  # building takes a minute: a sweep may have been started since
        data_dir = str(self._data_dir())
        units = self.options.source / "systemd/system"
        for path in sorted(path for path in units.rglob("*") if path.is_file()):
            self._put(self.paths.units / path.relative_to(units), unit_text(path.read_text(), self.paths, data_dir))
        point(self.paths.current, self.release)
        self.paths.command.parent.mkdir(parents=True, exist_ok=True)
        point(self.paths.command, self.paths.current / "bin/sweepscope")
        files = [str(path) for path in (*self._replaced, self.paths.command)]
        for name in sorted(set(self._installed_files()) - set(files)):
            self._remove(Path(name))  # a file of the release before that this one does not have
        self._put(self.paths.manifest, json.dumps({"files": files, "release": self.stamp}, indent=1))

    def _installed_files(self) -> list[str]:
        if not self.paths.manifest.exists():
            return []
        files = json.loads(self.paths.manifest.read_text())["files"]
        return [name for name in files if Path(name) != self.paths.config]

    def _start(self) -> None:
        user = self.paths.user
        removed = [path.name for path in self._replaced if path.suffix == ".service" and not path.exists()]
        if removed:
            systemctl("stop", *removed, user=user)
        systemctl("daemon-reload", user=user)
        systemctl("enable", "--quiet", TARGET, user=user)
        restart(user=user)

    def _remove_old_releases(self, before: Path | None) -> None:
        """Keep this release and the one before; environments of interrupted installations go too."""
        for old in self.paths.releases.iterdir():
            if old.resolve() not in (self.release.resolve(), before):
                shutil.rmtree(old, ignore_errors=True)

    def _put(self, path: Path, text: str) -> None:
        self._replaced.setdefault(path, path.read_text() if path.exists() else None)
        put(path, text)

    def _remove(self, path: Path) -> None:
        if path.exists():
            self._replaced.setdefault(path, path.read_text())
            _restore(path, None)

    # ---- rolling back ----

    def _roll_back(self, before: Path | None) -> None:
        """Restore everything; each step is tried even if the one before failed."""
        switched = self._current() == self.release.resolve()
        systemd, user = switched and self._uses_systemd(), self.paths.user
        steps: list[Callable[[], Any]] = []
        if systemd:
            steps.append(lambda: systemctl("stop", TARGET, ALL_SERVICES, user=user))
        if switched:
            steps.append(lambda: self._point_back(before))
        # before the files: this frees space where the disk is full
        steps.append(lambda: shutil.rmtree(self.release, ignore_errors=True))
        steps += [partial(_restore, path, text) for path, text in self._replaced.items()]
        if systemd:
            steps.append(lambda: systemctl("daemon-reload", user=user))
        if systemd and before is not None:
            steps.append(self._start_again)
        for step in steps:
            try:
                step()
            except (OSError, SweepscopeError) as error:
                self.say(f"rolling back: {error}")

    def _point_back(self, before: Path | None) -> None:
        if before is not None:
            point(self.paths.current, before)
            return
        self.paths.current.unlink(missing_ok=True)
        self.paths.command.unlink(missing_ok=True)

    def _start_again(self) -> None:
        restart(user=self.paths.user)
        self.say("the old services are ready again")


def _restore(path: Path, text: str | None) -> None:
    if text is not None:
        put(path, text)
        return
    path.unlink(missing_ok=True)
    if path.parent.name.startswith("sweepscope-"):  # a drop-in folder of ours
        with suppress(OSError):  # it is not empty
            path.parent.rmdir()


def base_python(*, user: bool) -> str:
    """The interpreter below our environment, or one of the same version that the services can reach.

    Raises:
        InstallError: there is only one in a home folder, which the services of the machine do not see.
    """
    own = str(getattr(sys, "_base_executable", None) or sys.executable)
    if user or not own.startswith(("/home/", "/root/")):
        return own
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    for place in ("/usr/local/bin", "/usr/bin"):
        if Path(f"{place}/python{version}").exists():
            return f"{place}/python{version}"
    raise InstallError(f"services cannot use the Python in {own}: install python{version} for the machine")
