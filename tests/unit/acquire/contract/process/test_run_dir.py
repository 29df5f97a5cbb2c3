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
    client_run_dir,
    endpoint,
    is_locked,
    lock_service,
    prepare_run_dir,
    service_run_dir,
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
