"""The appliance installed in a root of its own, under a systemd of its own: its whole life, and who is kept out."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from typing import Any

import pytest

from tests.fakes.processes.ports import free_port
from tests.fakes.processes.throwaway_root import PACKAGES_INSIDE, SOURCE_INSIDE, RootUnavailableError, ThrowawayRoot
from tests.needs import missing_here, need

pytestmark = [pytest.mark.shares_processes, pytest.mark.slow, pytest.mark.timeout(400)]
SERVICES = ("daemon", "writer", "worker", "viewer")
# the root shares its network with the machine
PAGE_PORT, GATE_PORT = free_port(), free_port(4)
CONFIG = f"""
[storage]
data_dir = "/var/lib/sweepscope/scans"
[camera]
width = 128
height = 96
[sweep]
steps_per_frame = 12
max_rate_hz = 100.0
[simulation]
time_scale = 0.001
[viewer]
port = {PAGE_PORT}
[network]
host = "127.0.0.1"
port = {GATE_PORT}
"""
SCAN = ("sweepscope", "scan", "--wait", "--json")
LONG = ("--steps-per-frame", "1", "--last-steps", "4400")
"""Takes many seconds even on a simulated rig without waits: it has to be caught in its middle."""


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ThrowawayRoot]:
    """The appliance, installed from this clone, with an operator in the rig's group and a stranger."""
    need("systemd")
    if os.geteuid() != 0 or shutil.which("unshare") is None:
        missing_here("a root of its own can be made by root only, with unshare")
    folder = tmp_path_factory.mktemp("root")
    try:
        with ThrowawayRoot(folder) as made:
            prepare(made)
            yield made
    except RootUnavailableError as error:
        missing_here(f"this machine allows no root of its own: {error}")


def prepare(root: ThrowawayRoot) -> None:
    root.path("/etc/sweepscope").mkdir()
    root.path("/etc/sweepscope/rig.toml").write_text(CONFIG)
    install(root)
    root.run("sweepscope", "keys", "make", "--server")
    root.run("useradd", "--groups", "sweepscope", "microscopist")
    root.run("useradd", "stranger")


def install(root: ThrowawayRoot, *words: str, **more: Any) -> str:
    words = ("install", "--packages-from", PACKAGES_INSIDE, *words)
    # the kernels of a first installation are compiled by whatever processors there are
    done = root.sweepscope_from_clone(*words, deadline_s=900.0, **more)
    return done.stdout + done.stderr


def show(root: ThrowawayRoot, service: str, key: str) -> str:
    return root.run("systemctl", "show", "--value", f"--property={key}", f"sweepscope-{service}.service").stdout.strip()


def names(root: ThrowawayRoot, folder: str) -> set[str]:
    return {path.name for path in root.path(folder).iterdir()}


def test_all_services_are_ready_after_installing_and_run_as_the_rigs_user(root: ThrowawayRoot) -> None:
    assert {show(root, service, "ActiveState") for service in SERVICES} == {"active"}
    for service in SERVICES:
        pid = show(root, service, "MainPID")
        assert root.run("stat", "-c", "%U", f"/proc/{pid}").stdout.strip() == "sweepscope"


def test_the_doctor_finds_nothing_wrong_for_a_member_of_the_group(root: ThrowawayRoot) -> None:
    said = json.loads(root.run("sweepscope", "doctor", "--json", user="microscopist").stdout)
    assert [finding for finding in said["findings"] if finding["level"] == "wrong"] == []


def test_a_member_of_the_group_takes_a_complete_scan_and_may_read_it(root: ThrowawayRoot) -> None:
    end = json.loads(root.run(*SCAN, user="microscopist").stdout)
    assert (end["outcome"], end["missing"]) == ("complete", 0)
    root.run("test", "-r", f"{end['path']}/scan.h5", user="microscopist")


def test_log_lines_of_a_scan_are_found_by_its_uid(root: ThrowawayRoot) -> None:
    end = json.loads(root.run(*SCAN, user="microscopist").stdout)
    lines = root.run("sweepscope", "logs", "--scan", end["scan_uid"], "--json").stdout.splitlines()
    assert {json.loads(line)["SWEEPSCOPE_SERVICE"] for line in lines} >= {"daemon", "worker"}


def test_a_stranger_gets_no_status_and_sends_no_command(root: ThrowawayRoot) -> None:
    for words in (("status",), ("stop",), ("jog", "10")):
        assert root.run("sweepscope", *words, user="stranger", check=False).returncode == 3


_KNOCK = """
import socket, sys
for lane in ("frames", "live", "results", "status", "command"):
    try:
        socket.socket(socket.AF_UNIX).connect(f"/run/sweepscope/{lane}.sock")
        print(lane, "open")
    except OSError as error:
        print(lane, type(error).__name__)
"""


def test_a_stranger_reaches_no_lane_and_the_operator_reaches_all(root: ThrowawayRoot) -> None:
    answers = root.run("/usr/bin/python3", "-c", _KNOCK, user="stranger").stdout.split()[1::2]
    assert answers == ["PermissionError"] * 5
    assert root.run("/usr/bin/python3", "-c", _KNOCK, user="microscopist").stdout.split()[1::2] == ["open"] * 5


def test_a_stranger_reads_neither_scans_nor_the_pages_address(root: ThrowawayRoot) -> None:
    for path in ("/var/lib/sweepscope/scans", "/run/sweepscope/viewer.url"):
        assert root.run("cat" if path.endswith("url") else "ls", path, user="stranger", check=False).returncode
    root.run("cat", "/run/sweepscope/viewer.url", user="microscopist")


_PAGE = f"""
import http.client
page = http.client.HTTPConnection("127.0.0.1", {PAGE_PORT}, timeout=5)
page.request("GET", "/")
print(page.getresponse().status)
"""


def test_a_stranger_who_asks_for_the_page_sees_no_controls(root: ThrowawayRoot) -> None:
    assert root.run("/usr/bin/python3", "-c", _PAGE, user="stranger").stdout.strip() == "401"


def test_no_service_logs_the_token_of_the_page(root: ThrowawayRoot) -> None:
    token = root.path("/run/sweepscope/viewer.url").read_text().strip().partition("token=")[2]
    assert len(token) > 20
    assert token not in root.run("journalctl", "--no-pager", "--all").stdout


def test_a_far_console_needs_a_key_that_the_rig_knows_and_nobody_reads_the_rigs_own(root: ThrowawayRoot) -> None:
    rigs_key = root.run("sweepscope", "keys", "list").stdout.splitlines()[1].split()[-1]
    for user in ("microscopist", "stranger"):
        root.run("mkdir", "-p", "-m", "777", f"/tmp/{user}")
        key = far(root, user, "keys", "make").stdout.split()[-1]
        if user == "microscopist":
            root.run("sweepscope", "keys", "allow", user, key)
    root.until(lambda: show(root, "gateway", "ActiveState") == "active", "the gateway finds its key")
    where = ("--connect", f"tcp://127.0.0.1:{GATE_PORT}", "--server-key", rigs_key)
    # the gateway looks at its list of keys once a second
    known = ("status", "--json", *where)
    root.until(lambda: not far(root, "microscopist", *known, check=False).returncode, "the gateway knows the key")
    assert json.loads(far(root, "microscopist", *known).stdout)["state"] == "idle"
    assert far(root, "stranger", "status", *where, check=False).returncode == 3
    for user in ("microscopist", "stranger"):
        assert root.run("cat", "/etc/sweepscope/keys/server.key", user=user, check=False).returncode
    secret = root.path("/etc/sweepscope/keys/server.key").read_text().split('secret = "')[1][:40]
    assert secret not in root.run("journalctl", "--no-pager", "--all").stdout


def far(root: ThrowawayRoot, user: str, *words: str, check: bool = True) -> subprocess.CompletedProcess[str]:
    """A command of somebody who has nothing of the rig but its address."""
    nothing = {"XDG_CONFIG_HOME": f"/tmp/{user}", "SWEEPSCOPE_RUN": f"/tmp/{user}"}
    return root.run("sweepscope", *words, user=user, check=check, **nothing)


def test_a_frozen_daemon_is_restarted_and_its_scan_goes_on(root: ThrowawayRoot) -> None:
    drop_in = root.path("/etc/systemd/system/sweepscope-daemon.service.d")
    drop_in.mkdir()
    (drop_in / "quick.conf").write_text("[Service]\nWatchdogSec=3s\n")
    root.run("systemctl", "daemon-reload")
    root.run("systemctl", "restart", "sweepscope-daemon.service")
    root.until(lambda: show(root, "daemon", "ActiveState") == "active", "the daemon is ready")
    begun = json.loads(root.run("sweepscope", "scan", "--json", *LONG).stdout)
    pid = show(root, "daemon", "MainPID")
    root.until(lambda: status(root)["committed"] > 5, "frames are committed")
    root.run("kill", "-STOP", pid)
    root.until(lambda: show(root, "daemon", "MainPID") not in (pid, "0"), "another daemon")
    root.until(lambda: show(root, "daemon", "ActiveState") == "active", "it is ready")
    assert show(root, "daemon", "NRestarts") == "1"
    end = root.run("sweepscope", "resume", begun["path"], "--wait", "--json")
    assert json.loads(end.stdout)["outcome"] == "complete"


def status(root: ThrowawayRoot) -> dict[str, Any]:
    return json.loads(root.run("sweepscope", "status", "--json").stdout)


def test_an_update_keeps_configuration_and_scans_and_switches_the_release(root: ThrowawayRoot) -> None:
    scans, release = names(root, "/var/lib/sweepscope/scans"), root.path("/opt/sweepscope/current").readlink()
    install(root, "--no-start")
    assert root.path("/opt/sweepscope/current").readlink() != release
    assert names(root, "/var/lib/sweepscope/scans") == scans
    assert root.path("/etc/sweepscope/rig.toml").read_text() == CONFIG
    assert {show(root, service, "ActiveState") for service in SERVICES} == {"active"}


def test_a_failed_update_leaves_the_old_release_running(root: ThrowawayRoot) -> None:
    release = root.path("/opt/sweepscope/current").readlink()
    pid = show(root, "daemon", "MainPID")
    rules = root.path("/etc/sweepscope/rig.toml")
    rules.write_text(CONFIG + "\n[camera_typo]\n")  # the new program refuses it before anything is switched
    said = install(root, check=False)
    rules.write_text(CONFIG)
    assert "as before" in said
    assert root.path("/opt/sweepscope/current").readlink() == release
    assert show(root, "daemon", "MainPID") == pid


_PARTS = ("acquire", "process", "tui", "systemd", "pyproject.toml", "constraints.txt", "README.md")


def test_a_release_whose_daemon_does_not_start_is_taken_back(root: ThrowawayRoot) -> None:
    release = root.path("/opt/sweepscope/current").readlink()
    root.run("mkdir", "/srv/broken")
    root.run("cp", "-r", *(f"{SOURCE_INSIDE}/{part}" for part in _PARTS), "/srv/broken")
    daemon = root.path("/srv/broken/acquire/daemon/service.py")
    daemon.write_text(
        daemon.read_text().replace("def run_daemon(", "def run_daemon(*_):\n    raise SystemExit(1)\n\n\ndef _(")
    )
    unit = root.path("/srv/broken/systemd/system/sweepscope-viewer.service")
    unit.write_text(unit.read_text() + "# of the broken release\n")
    said = install(root, source="/srv/broken", check=False)
    assert "sweepscope-daemon.service does not get ready" in said, said
    assert f"{release.name} is in place as before" in said, said
    assert "the old services are ready again" in said, said
    assert root.path("/opt/sweepscope/current").readlink() == release
    assert {show(root, service, "ActiveState") for service in SERVICES} == {"active"}
    assert "broken" not in root.path("/etc/systemd/system/sweepscope-viewer.service").read_text()
    assert status(root)["state"] == "idle"


def test_a_disk_that_is_full_during_an_update_changes_nothing(root: ThrowawayRoot) -> None:
    release, pid = root.path("/opt/sweepscope/current").readlink(), show(root, "daemon", "MainPID")
    # seen by the installer alone: the services keep theirs
    full = ("unshare", "-m", "sh", "-c", 'mount -t tmpfs -o size=1m tmpfs /opt/sweepscope/releases && exec "$@"', "sh")
    said = install(root, within=full, check=False)
    assert "No space left on device" in said, said
    assert f"{release.name} is in place as before" in said, said
    assert root.path("/opt/sweepscope/current").readlink() == release
    assert show(root, "daemon", "MainPID") == pid


def test_uninstalling_leaves_nothing_but_the_data(root: ThrowawayRoot) -> None:
    scans = names(root, "/var/lib/sweepscope/scans")
    root.sweepscope_from_clone("uninstall")
    assert names(root, "/var/lib/sweepscope/scans") == scans | {"rig.toml"}
    left = root.run(
        "find",
        "/etc",
        "/opt",
        "/usr/lib",
        "/usr/local/bin",
        "/run",
        "/var",
        "-xdev",
        "-name",
        "*sweepscope*",
        check=False,
    ).stdout.split()
    assert [path for path in left if SOURCE_INSIDE not in path] == ["/var/lib/sweepscope"]
    assert root.run("getent", "passwd", "sweepscope", check=False).returncode
    assert root.run("getent", "group", "sweepscope", check=False).returncode
