"""Owns installing and updating: builds the new release beside the old one, and goes back to it if the new one fails."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import tomli_w

from acquire.contract.config.load import load_config
from acquire.contract.errors import SweepscopeError
from tui.install.machine import InstallError, point, put, run, systemctl, systemd_runs
from tui.install.paths import TARGET, Places
from tui.install.services import refuse_during_a_sweep, restart
from tui.install.units import unit_text

OWNER = "sweepscope"


@dataclass(frozen=True)
class Wishes:
    """What the person wants."""

    source: Path
    """Tree with pyproject.toml, constraints.txt and systemd/."""
    settings: dict[str, dict[str, Any]]
    """rig.toml of a first installation; an update keeps the configuration that is there."""
    packages_from: Path | None = None
    """site-packages of another environment to share instead of downloading the dependencies."""
    start: bool = True


@dataclass
class Installer:
    """One run. ``steps`` says what will be done; :meth:`go` does it, and undoes the switch if the services fail."""

    places: Places
    wishes: Wishes
    say: Callable[[str], None]
    stamp: str = field(default_factory=lambda: datetime.now(UTC).strftime("%Y%m%d-%H%M%S-%f"))
    _replaced: dict[Path, str | None] = field(default_factory=dict)

    @property
    def release(self) -> Path:
        """The new environment."""
        return self.places.releases / self.stamp

    def steps(self) -> list[tuple[str, Callable[[], None]]]:
        """Words and deeds in their order; up to the switch nothing that runs is touched."""
        found = [
            ("see that no sweep is running", self._see_no_sweep),
            (f"build a Python environment in {self.release}", self._build),
            ("try the new program", self._try),
            (self._config_words(), self._configure),
        ]
        if not self.places.user:
            found.append(("make user and group, folders and device rules", self._prepare_machine))
        found.append((f"put units into {self.places.units}, link {self.places.command} and switch", self._switch))
        if self.wishes.start and systemd_runs(user=self.places.user):
            found.append((f"start {TARGET} and wait until all services are ready", self._start))
        return found

    def go(self) -> None:
        """Do all steps.

        Raises:
            InstallError: a step failed; the old release runs as before.
        """
        before = self._in_place()
        for words, deed in self.steps():
            self.say(words)
            try:
                deed()
            except BaseException as error:
                self._go_back(before)
                if not isinstance(error, (SweepscopeError, OSError, KeyboardInterrupt)):
                    raise
                kept = f"{before.name} is in place as before" if before else "nothing is installed"
                raise InstallError(f"{words}: {str(error) or 'interrupted'}; {kept}") from None
        self._tidy(before)

    def _in_place(self) -> Path | None:
        return self.places.current.resolve() if self.places.current.is_symlink() else None

    # ---- before the switch ----

    def _see_no_sweep(self) -> None:
        refuse_during_a_sweep(self.places)

    def _build(self) -> None:
        self.places.releases.mkdir(parents=True, exist_ok=True)
        self.places.home.chmod(0o755)
        # our own pip installs into it: Debian's Python comes without one
        run(base_python(user=self.places.user), "-m", "venv", "--without-pip", self.release)
        python, constraints = self.release / "bin/python", self.wishes.source / "constraints.txt"
        pip = (sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--disable-pip-version-check")
        if self.wishes.packages_from is None:
            run(*pip, "--constraint", constraints, self.wishes.source)
            return
        run(*pip, "--no-deps", self.wishes.source)
        site = next((self.release / "lib").glob("python3*/site-packages"))
        (site / "shared.pth").write_text(f"{self.wishes.packages_from}\n")

    def _try(self) -> None:
        run(self.release / "bin/sweepscope", "version", timeout_s=60)

    def _config_words(self) -> str:
        config = self.places.config
        return f"keep the configuration {config}" if config.exists() else f"write the configuration {config}"

    def _configure(self) -> None:
        if not self.places.config.exists():
            put(self.places.config, tomli_w.dumps(self.wishes.settings))
            self._replaced[self.places.config] = None
        load_config(str(self.places.config), environ={})

    def _prepare_machine(self) -> None:
        for name, target in self.places.system_files().items():
            self._put(target, (self.wishes.source / "systemd" / name).read_text())
        files = self.places.system_files()
        run("systemd-sysusers", files["sysusers.d/sweepscope.conf"])
        run("systemd-tmpfiles", "--create", files["tmpfiles.d/sweepscope.conf"])
        data = self._data_dir()
        if not data.exists():
            data.mkdir(parents=True, mode=0o750)
            shutil.chown(data, OWNER, OWNER)
        if systemd_runs(user=False) and shutil.which("udevadm") and Path("/run/udev/control").exists():
            run("udevadm", "control", "--reload", timeout_s=30)
            run("udevadm", "trigger", "--subsystem-match=tty", "--subsystem-match=video4linux", timeout_s=30)

    # ---- the switch and after ----

    def _switch(self) -> None:
        refuse_during_a_sweep(self.places)  # building takes a minute, in which one may have begun
        data_dir = str(self._data_dir())
        for path in sorted((self.wishes.source / "systemd/system").iterdir()):
            self._put(self.places.units / path.name, unit_text(path.read_text(), self.places, data_dir))
        point(self.places.current, self.release)
        self.places.command.parent.mkdir(parents=True, exist_ok=True)
        point(self.places.command, self.places.current / "bin/sweepscope")
        files = [str(path) for path in (*self._replaced, self.places.command)]
        for name in sorted(set(self._listed()) - set(files)):
            self._remove(Path(name))  # the release before put it there, this one does without
        self._put(self.places.manifest, json.dumps({"files": files, "release": self.stamp}, indent=1))

    def _listed(self) -> list[str]:
        if not self.places.manifest.exists():
            return []
        files = json.loads(self.places.manifest.read_text())["files"]
        return [name for name in files if Path(name) != self.places.config]

    def _start(self) -> None:
        user = self.places.user
        removed = [path.name for path in self._replaced if path.suffix == ".service" and not path.exists()]
        if removed:
            systemctl("stop", *removed, user=user)
        systemctl("daemon-reload", user=user)
        systemctl("enable", "--quiet", TARGET, user=user)
        restart(user=user)

    def _tidy(self, before: Path | None) -> None:
        """Keep this release and the one before; what an installation that was killed left behind goes too."""
        for old in self.places.releases.iterdir():
            if old.resolve() not in (self.release.resolve(), before):
                shutil.rmtree(old, ignore_errors=True)

    def _put(self, path: Path, text: str) -> None:
        self._replaced.setdefault(path, path.read_text() if path.exists() else None)
        put(path, text)

    def _remove(self, path: Path) -> None:
        if path.exists():
            self._replaced.setdefault(path, path.read_text())
            path.unlink()

    def _data_dir(self) -> Path:
        return load_config(str(self.places.config), environ={}).data_dir

    # ---- back ----

    def _go_back(self, before: Path | None) -> None:
        """Put everything back; each step is tried even if the one before failed."""
        switched = self._in_place() == self.release.resolve()
        steps: list[Callable[[], None]] = []
        if switched and self.wishes.start:
            steps.append(lambda: self._ask_systemd("stop", TARGET, "sweepscope-*.service"))
        if switched:
            steps.append(lambda: self._point_back(before))
        # first: it gives room back where the disk is full
        steps.append(lambda: shutil.rmtree(self.release, ignore_errors=True))
        steps += [partial(_restore, path, text) for path, text in self._replaced.items()]
        if switched:
            steps.append(lambda: self._ask_systemd("daemon-reload"))
        if switched and before is not None and self.wishes.start:
            steps.append(self._start_again)
        for step in steps:
            try:
                step()
            except (OSError, SweepscopeError) as error:
                self.say(f"putting back: {error}")

    def _point_back(self, before: Path | None) -> None:
        if before is not None:
            point(self.places.current, before)
            return
        self.places.current.unlink(missing_ok=True)
        self.places.command.unlink(missing_ok=True)

    def _start_again(self) -> None:
        if systemd_runs(user=self.places.user):
            restart(user=self.places.user)
            self.say("the old services are ready again")

    def _ask_systemd(self, *words: str) -> None:
        if systemd_runs(user=self.places.user):
            systemctl(*words, user=self.places.user)


def _restore(path: Path, text: str | None) -> None:
    if text is None:
        path.unlink(missing_ok=True)
    else:
        put(path, text)


def base_python(*, user: bool) -> str:
    """The interpreter under the environment that runs us, or one like it that the services can reach.

    Raises:
        InstallError: there is only one in somebody's home, which services of the machine do not see.
    """
    own = str(getattr(sys, "_base_executable", None) or sys.executable)
    if user or not own.startswith(("/home/", "/root/")):
        return own
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    for place in ("/usr/local/bin", "/usr/bin"):
        if Path(f"{place}/python{version}").exists():
            return f"{place}/python{version}"
    raise InstallError(f"services cannot use the Python in {own}: install python{version} for the machine")
