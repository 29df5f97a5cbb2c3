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
from tui.install.install import Installer, Wishes
from tui.install.journal import journal_command, pack, without_home
from tui.install.machine import InstallError, point, run
from tui.install.paths import Places, machine_places, user_places
from tui.install.uninstall import uninstall_steps
from tui.install.units import unit_text

SOURCE = ROOT
DAEMON = (SOURCE / "systemd/system/sweepscope-daemon.service").read_text()


@pytest.fixture(autouse=True)
def nothing_of_this_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the systemd nor the rig of whoever runs the tests."""
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    monkeypatch.setenv("SWEEPSCOPE_RUN", str(tmp_path / "nobody-here"))


def places(tmp_path: Path) -> Places:
    return user_places({"HOME": str(tmp_path)})


def test_a_data_folder_under_home_stays_reachable_while_the_rest_of_home_is_hidden() -> None:
    text = unit_text(DAEMON, machine_places(), "/home/ann/scans")
    assert "ProtectHome=tmpfs\nBindPaths=/home/ann/scans\nReadWritePaths=/home/ann/scans\n" in text


def test_the_own_data_folder_needs_no_exception() -> None:
    assert "ReadWritePaths" not in unit_text(DAEMON, machine_places(), "/var/lib/sweepscope/scans")


def test_a_users_unit_asks_for_nothing_that_needs_root(tmp_path: Path) -> None:
    text = unit_text(DAEMON, places(tmp_path), "")
    assert f"ExecStart={tmp_path}/" in text
    keys = {line.partition("=")[0] for line in text.splitlines() if not line.startswith("#")}
    assert not keys & {"User", "Group", "StateDirectory", "DeviceAllow", "ProtectSystem", "PrivateNetwork"}


class FailingInstaller(Installer):
    """Its new program does not run."""

    def _build(self) -> None:
        self.release.mkdir(parents=True)

    def _try(self) -> None:
        raise InstallError("it does not run")


def test_a_new_release_that_does_not_run_is_never_switched_to(tmp_path: Path) -> None:
    here = places(tmp_path)
    old = here.releases / "old"
    old.mkdir(parents=True)
    point(here.current, old)
    installer = FailingInstaller(here, Wishes(SOURCE, {}, start=False), lambda _: None)
    with pytest.raises(InstallError, match="it does not run; old is in place as before"):
        installer.go()
    assert here.current.resolve() == old.resolve()
    assert list(here.releases.iterdir()) == [old]


def test_what_was_never_installed_cannot_be_uninstalled(tmp_path: Path) -> None:
    with pytest.raises(InstallError, match="nothing is installed"):
        uninstall_steps(places(tmp_path), lambda _: None)


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


def test_what_is_said_above_a_line_that_a_user_cannot_have_goes_with_it(tmp_path: Path) -> None:
    text = unit_text(DAEMON, places(tmp_path), "")
    assert "# never give up" in text
    assert "compiled kernels are kept here" not in text


def source_tree(tmp_path: Path, pyproject: str) -> Path:
    """A source of a release that is put together for one test."""
    tree = tmp_path / "source"
    shutil.copytree(SOURCE / "systemd", tree / "systemd")
    (tree / "pyproject.toml").write_text(pyproject)
    (tree / "constraints.txt").write_text("")
    return tree


def installed(tmp_path: Path) -> tuple[Places, Path]:
    """Places with an old release in them."""
    here = places(tmp_path)
    old = here.releases / "old"
    old.mkdir(parents=True)
    point(here.current, old)
    return here, old


def test_a_release_that_pip_cannot_install_leaves_the_old_one_in_place(tmp_path: Path) -> None:
    here, old = installed(tmp_path)
    wishes = Wishes(source_tree(tmp_path, "this is no TOML ["), {}, packages_from=tmp_path, start=False)
    with pytest.raises(InstallError, match=r"pip.* failed: .*old is in place as before"):
        Installer(here, wishes, lambda _: None).go()
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
        raise KeyError("an error that nobody thought of")


def test_after_a_switch_that_failed_units_list_and_link_are_the_old_ones_again(tmp_path: Path) -> None:
    here, old = installed(tmp_path)
    here.units.mkdir(parents=True)
    (here.units / "sweepscope-daemon.service").write_text("the old one")
    (here.units / "sweepscope-gone.service").write_text("a unit that the new release does without")
    files = [str(path) for path in here.units.iterdir()]
    here.manifest.write_text(json.dumps({"files": files, "release": "old"}))
    before = {path: path.read_text() for path in (*here.units.iterdir(), here.manifest)}
    with pytest.raises(KeyError):
        SwitchingInstaller(here, Wishes(SOURCE, {}, start=False), lambda _: None).go()
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
    installer = QuickInstaller(here, Wishes(SOURCE, {}, start=False), lambda _: None)
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
            QuickInstaller(here, Wishes(SOURCE, {}, start=False), lambda _: None).go()
        with pytest.raises(InstallError, match="a sweep is running"):
            uninstall_steps(here, lambda _: None)[0][1]()
    assert list(here.releases.iterdir()) == [old]


def test_a_persons_own_key_outlives_uninstalling(tmp_path: Path) -> None:
    here, _ = installed(tmp_path)
    here.manifest.write_text(json.dumps({"files": [], "release": "old"}))
    key = here.config.parent / "keys/own.key"
    key.parent.mkdir(parents=True)
    key.touch()
    for _words, deed in uninstall_steps(here, lambda _: None):
        deed()
    assert key.exists()
    assert not here.home.exists()
