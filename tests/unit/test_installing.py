"""Pieces of installing: unit texts, going back, the packed report."""

from __future__ import annotations

import stat
import tarfile
from pathlib import Path

import pytest

from acquire.contract.errors import SweepscopeError
from tui.installing.install import Installer, Wishes
from tui.installing.journal import journal_command, pack, without_home
from tui.installing.machine import InstallError, point, run
from tui.installing.places import Places, machine_places, user_places
from tui.installing.uninstall import uninstall_steps
from tui.installing.units import unit_text

SOURCE = Path(__file__).parents[2]
DAEMON = (SOURCE / "systemd/system/sweepscope-daemon.service").read_text()


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
