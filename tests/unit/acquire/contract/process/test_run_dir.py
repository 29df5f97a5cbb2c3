"""Where sockets and locks are, and what is said when they cannot be."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from pathlib import Path

import pytest

from acquire.contract.errors import AlreadyRunningError, ConfigError, NoServiceError
from acquire.contract.process.run_dir import (
    LANES,
    MAX_SOCKET_PATH_BYTES,
    client_run_dir,
    endpoint,
    is_locked,
    is_served,
    lock_service,
    prepare_run_dir,
    service_run_dir,
    temporary_run_dir,
)


def listen(path):
    server = socket.socket(socket.AF_UNIX)
    server.bind(str(path))
    server.listen()
    return server


def test_services_take_the_first_place_that_is_named():
    assert service_run_dir({"SWEEPSCOPE_RUN": "/a", "XDG_RUNTIME_DIR": "/b"}) == Path("/a")
    assert service_run_dir({"XDG_RUNTIME_DIR": "/b"}) == Path("/b/sweepscope")
    assert service_run_dir({}) == Path("/run/sweepscope")


def test_a_client_takes_the_place_where_a_daemon_listens(run_dir):
    (run_dir / "sweepscope").mkdir()
    with listen(run_dir / "sweepscope/command.sock"):
        assert client_run_dir({"XDG_RUNTIME_DIR": str(run_dir)}) == run_dir / "sweepscope"


def test_a_socket_that_a_dead_daemon_left_behind_does_not_count(run_dir):
    listen(run_dir / "command.sock").close()
    with pytest.raises(NoServiceError, match="sweepscope up"):
        client_run_dir({"SWEEPSCOPE_RUN": str(run_dir)})


def test_a_path_that_is_too_long_for_a_socket_is_an_error():
    with pytest.raises(ConfigError, match="107"):
        endpoint(Path("/" + "x" * 120), "frames")


def test_a_directory_that_is_too_long_for_sockets_is_refused_by_all_before_it_is_made(tmp_path):
    long = tmp_path / ("x" * 110)
    for use in (prepare_run_dir, is_served, lambda path: client_run_dir({"SWEEPSCOPE_RUN": str(path)})):
        with pytest.raises(
            ConfigError, match=r"xxx.*bytes, longer than the 107.*SWEEPSCOPE_RUN to a directory of at most 9\d bytes"
        ):
            use(long)
    assert not long.exists()


def test_the_longest_directory_that_is_offered_works_for_every_lane(run_dir):
    room = MAX_SOCKET_PATH_BYTES - len(os.fsencode(run_dir)) - len("/") - len("/command.sock")
    longest = run_dir / ("y" * room)
    assert prepare_run_dir(longest).is_dir()
    for lane in LANES:
        with listen(longest / f"{lane}.sock"):
            assert is_served(longest, lane)
    with pytest.raises(ConfigError):
        prepare_run_dir(run_dir / ("y" * (room + 1)))


def test_a_user_directory_that_is_too_long_is_told_where_no_daemon_runs():
    with pytest.raises(ConfigError, match="SWEEPSCOPE_RUN"):
        client_run_dir({"XDG_RUNTIME_DIR": "/" + "x" * 110})


def test_letters_count_as_bytes_and_a_name_that_is_no_utf8_is_refused():
    with pytest.raises(ConfigError, match="127 bytes"):
        endpoint(Path("/" + "\u00fc" * 55 + "abc"), "command")
    with pytest.raises(ConfigError, match="UTF-8"):
        endpoint(Path(os.fsdecode(b"/tmp/bad\xff")), "command")


def test_a_directory_for_temporary_files_that_is_too_long_or_missing_names_its_variable(monkeypatch, tmp_path):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "missing"))
    with pytest.raises(ConfigError, match="TMPDIR"):
        temporary_run_dir()
    deep = tmp_path / ("x" * 100)
    deep.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(deep))
    with pytest.raises(ConfigError, match="TMPDIR"):
        temporary_run_dir()
    assert list(deep.iterdir()) == []


def test_the_run_directory_is_private(run_dir):
    assert prepare_run_dir(run_dir / "new").stat().st_mode & 0o777 == 0o700


def test_a_run_directory_that_is_open_to_all_is_refused(run_dir):
    run_dir.chmod(0o777)
    with pytest.raises(ConfigError, match="chmod 0700"):
        prepare_run_dir(run_dir)


def test_a_second_service_is_refused_with_the_pid_of_the_first(run_dir):
    code = (
        "import sys; from pathlib import Path; from acquire.contract.process.run_dir import lock_service\n"
        "lock = lock_service(Path(sys.argv[1]), 'writer'); print('locked', flush=True); sys.stdin.read()"
    )
    first = subprocess.Popen([sys.executable, "-c", code, str(run_dir)], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    with first:
        assert first.stdout.readline() == b"locked\n"
        with pytest.raises(AlreadyRunningError, match=str(first.pid)):
            lock_service(run_dir, "writer")
        assert is_locked(run_dir / "writer.lock")
        first.stdin.close()
    assert not is_locked(run_dir / "writer.lock")
    lock = lock_service(run_dir, "writer")
    assert (run_dir / "writer.lock").read_text().strip() == str(os.getpid())
    lock.release()
