"""Pieces of installing: unit texts, going back, the packed report."""

from __future__ import annotations

import json
import shutil
import stat
import tarfile
from pathlib import Path

import pytest

from acquire.contract.errors import SweepscopeError
from tests import ROOT
from tests.fakes.fake_daemon import SWEEPING, FakeDaemon
from tui.install.install import Installer, InstallOptions
from tui.install.journal import journal_command, pack, without_home
from tui.install.machine import InstallError, point, run
from tui.install.paths import InstallPaths, machine_paths, user_paths
from tui.install.systemd import unit_text
from tui.install.uninstall import uninstall_steps

SOURCE = ROOT
UNITS = {path.name: path.read_text() for path in (SOURCE / "systemd/system").rglob("*") if path.is_file()}
COMMON = UNITS["10-common.conf"]
FOR_A_USER = {
    *("Description", "After", "Before", "PartOf", "Wants", "StartLimitIntervalSec", "WantedBy", "Environment", "UMask"),
    *("Type", "NotifyAccess", "ExecCondition", "ExecStart", "Restart", "RestartSec", "RemainAfterExit", "KillMode"),
    *("WatchdogSec", "WatchdogSignal", "TimeoutStartSec", "TimeoutStopSec", "SuccessExitStatus", "NoNewPrivileges"),
    *("RuntimeDirectory", "RuntimeDirectoryMode", "RuntimeDirectoryPreserve", "LockPersonality", "RestrictRealtime"),
    *("RestrictSUIDSGID", "MemoryDenyWriteExecute", "SystemCallArchitectures", "SystemCallFilter"),
    *("SystemCallErrorNumber", "RestrictAddressFamilies"),
}
"""What systemd grants to a user without root."""


@pytest.fixture(autouse=True)
def nothing_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the systemd nor the rig of this machine."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("SWEEPSCOPE_RUN", str(tmp_path / "nobody-here"))


def paths(tmp_path: Path) -> InstallPaths:
    return user_paths({"HOME": str(tmp_path)})


def test_a_data_folder_under_home_stays_reachable_while_the_rest_of_home_is_hidden() -> None:
    text = unit_text(COMMON, machine_paths(), "/home/ann/scans")
    assert "ProtectHome=tmpfs\nBindPaths=/home/ann/scans\nReadWritePaths=/home/ann/scans\n" in text


def test_the_own_data_folder_needs_no_exception() -> None:
    assert "ReadWritePaths" not in unit_text(COMMON, machine_paths(), "/var/lib/sweepscope/scans")


@pytest.mark.parametrize("name", UNITS)
def test_a_users_unit_asks_for_nothing_that_needs_root_and_keeps_the_rest(tmp_path: Path, name: str) -> None:
    settings = _settings(unit_text(UNITS[name], paths(tmp_path), ""))
    assert set(settings) <= FOR_A_USER
    assert settings.get("ExecStart", f"{tmp_path}/").startswith(f"{tmp_path}/")
    assert settings.get("WantedBy", "default.target") in ("default.target", "sweepscope.target")
    assert set(_settings(UNITS[name])) & FOR_A_USER - {"Environment"} <= set(settings)


def _settings(text: str) -> dict[str, str]:
    return dict(line.split("=", 1) for line in text.splitlines() if "=" in line and not line.startswith("#"))


def test_units_name_the_configuration_of_the_installation(tmp_path: Path) -> None:
    here = paths(tmp_path)
    assert f"Environment=SWEEPSCOPE_CONFIG={here.config}\n" in unit_text(COMMON, here, "")
    assert "Environment=SWEEPSCOPE_CONFIG=/etc/sweepscope/rig.toml\n" in unit_text(COMMON, machine_paths(), "/srv")


class FailingInstaller(Installer):
    """Its new program does not run."""

    def _build(self) -> None:
        self.release.mkdir(parents=True)

    def _try(self) -> None:
        raise InstallError("it does not run")


def test_a_new_release_that_does_not_run_is_never_switched_to(tmp_path: Path) -> None:
    here = paths(tmp_path)
    old = here.releases / "old"
    old.mkdir(parents=True)
    point(here.current, old)
    installer = FailingInstaller(here, InstallOptions(SOURCE, {}, start=False), lambda _: None)
    with pytest.raises(InstallError, match="it does not run; old is in place as before"):
        installer.go()
    assert here.current.resolve() == old.resolve()
    assert list(here.releases.iterdir()) == [old]


def test_what_was_never_installed_cannot_be_uninstalled(tmp_path: Path) -> None:
    with pytest.raises(InstallError, match="nothing is installed"):
        uninstall_steps(paths(tmp_path), lambda _: None)


def test_a_command_that_fails_is_named_with_its_last_word(tmp_path: Path) -> None:
    with pytest.raises(InstallError, match="'ls .*' failed: .*No such file"):
        run("ls", tmp_path / "none")


def test_a_report_is_for_its_owner_only_and_replaces_nothing(tmp_path: Path) -> None:
    target = tmp_path / "report.tar.gz"
    pack(target, {"a.txt": "text"})
    assert stat.S_IMODE(target.stat().st_mode) == 0o600
    with tarfile.open(target) as archive:
        assert archive.getnames() == ["sweepscope-report/a.txt"]
    with pytest.raises(SweepscopeError, match="cannot write"):
        pack(target, {})


def test_names_of_people_are_taken_out_of_a_report() -> None:
    assert without_home("/home/ann/scans and /", ["/home/ann", "/"]) == "~/scans and /"


def test_logs_without_a_journal_say_where_to_look(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nonexistent")
    with pytest.raises(SweepscopeError, match="no journal here"):
        journal_command()


def test_comments_of_settings_that_a_user_cannot_have_are_left_out_too(tmp_path: Path) -> None:
    daemon = unit_text(UNITS["sweepscope-daemon.service"], paths(tmp_path), "")
    assert "# the loop runs" in daemon
    assert "compiled kernels" not in daemon and "compiled kernels" in UNITS["sweepscope-daemon.service"]
    assert daemon.endswith("[Install]\nWantedBy=sweepscope.target\n")


def source_tree(tmp_path: Path, pyproject: str) -> Path:
    """A source of a release that is put together for one test."""
    tree = tmp_path / "source"
    shutil.copytree(SOURCE / "systemd", tree / "systemd")
    (tree / "pyproject.toml").write_text(pyproject)
    (tree / "constraints.txt").write_text("")
    return tree


def installed(tmp_path: Path) -> tuple[InstallPaths, Path]:
    """Paths with an old release in them."""
    here = paths(tmp_path)
    old = here.releases / "old"
    old.mkdir(parents=True)
    point(here.current, old)
    return here, old


def test_a_release_that_pip_cannot_install_leaves_the_old_one_in_place(tmp_path: Path) -> None:
    here, old = installed(tmp_path)
    options = InstallOptions(source_tree(tmp_path, "this is no TOML ["), {}, packages_from=tmp_path, start=False)
    with pytest.raises(InstallError, match=r"pip.* failed: .*old is in place as before"):
        Installer(here, options, lambda _: None).go()
    assert here.current.resolve() == old.resolve()
    assert list(here.releases.iterdir()) == [old]
    assert not here.units.exists()


class SwitchingInstaller(Installer):
    """Its program is there at once, and its services do not start."""

    def _build(self) -> None:
        (self.release / "bin").mkdir(parents=True)

    def _try(self) -> None:
        pass

    def steps(self):
        return [*super().steps(), ("start", self._fail)]

    def _fail(self) -> None:
        raise KeyError("an unexpected error")


def test_after_a_switch_that_failed_units_list_and_link_are_the_old_ones_again(tmp_path: Path) -> None:
    here, old = installed(tmp_path)
    here.units.mkdir(parents=True)
    (here.units / "sweepscope-daemon.service").write_text("the old one")
    (here.units / "sweepscope-gone.service").write_text("a unit that the new release does without")
    files = [str(path) for path in here.units.iterdir()]
    here.manifest.write_text(json.dumps({"files": files, "release": "old"}))
    before = {path: path.read_text() for path in (*here.units.iterdir(), here.manifest)}
    with pytest.raises(KeyError):
        SwitchingInstaller(here, InstallOptions(SOURCE, {}, start=False), lambda _: None).go()
    assert {path: path.read_text() for path in (*here.units.iterdir(), here.manifest)} == before
    assert here.current.resolve() == old.resolve()
    assert not here.config.exists()


class QuickInstaller(SwitchingInstaller):
    """Its services start."""

    def _fail(self) -> None:
        pass


def test_an_update_removes_what_only_the_release_before_had_and_what_a_killed_one_left(tmp_path: Path) -> None:
    here, old = installed(tmp_path)
    (here.releases / "99999999-killed").mkdir()
    here.units.mkdir(parents=True)
    gone = here.units / "sweepscope-gone.service"
    gone.write_text("")
    here.manifest.write_text(json.dumps({"files": [str(gone)], "release": "old"}))
    installer = QuickInstaller(here, InstallOptions(SOURCE, {}, start=False), lambda _: None)
    installer.go()
    assert not gone.exists()
    assert set(here.releases.iterdir()) == {old, installer.release}
    assert here.current.resolve() == installer.release.resolve()


def test_neither_update_nor_uninstalling_disturbs_a_sweep(
    tmp_path: Path, run_dir: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("SWEEPSCOPE_RUN", str(run_dir))
    here, old = installed(tmp_path)
    here.manifest.write_text(json.dumps({"files": [], "release": "old"}))
    with FakeDaemon(run_dir, SWEEPING):
        with pytest.raises(InstallError, match=r"a sweep is running \(\d+ of 527 frames\)"):
            QuickInstaller(here, InstallOptions(SOURCE, {}, start=False), lambda _: None).go()
        with pytest.raises(InstallError, match="a sweep is running"):
            uninstall_steps(here, lambda _: None)[0][1]()
    assert list(here.releases.iterdir()) == [old]


def test_a_persons_own_key_outlives_uninstalling(tmp_path: Path) -> None:
    here, _ = installed(tmp_path)
    here.manifest.write_text(json.dumps({"files": [], "release": "old"}))
    key = here.config.parent / "keys/own.key"
    key.parent.mkdir(parents=True)
    key.touch()
    for _text, action in uninstall_steps(here, lambda _: None):
        action()
    assert key.exists()
    assert not here.home.exists()
