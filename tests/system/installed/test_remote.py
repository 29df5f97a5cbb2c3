"""The way in over TCP, on real sockets: a right key, a wrong one, none, one that may only watch, a revoked one."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import pytest
import zmq

from acquire.contract.config.model import NetworkConfig
from acquire.contract.errors import CommandRefusedError, ConfigError, NoServiceError
from acquire.contract.messaging.lanes import bind, connect, receive
from acquire.contract.messaging.messages import Command, Status
from acquire.remote.addresses import OFFERED, SPOKEN, Address
from acquire.remote.gateway import Gateway
from acquire.remote.keys import KeyPair, allow, make_pair, revoke, signature_of
from acquire.remote.tunnel import Tunnel
from tests.fakes.fake_daemon import PROGRESS, FakeDaemon
from tests.fakes.processes.ports import free_port
from tests.waiting import DEADLINE_S, WALL_CLOCK_S, wait_for
from tui.cli import run
from tui.client.rig_client import ProgressFeed, RigClient


@dataclass
class Far:
    """A rig with a gateway, and the keys of those who want in."""

    gateway: Gateway
    daemon: FakeDaemon
    folder: Path
    pairs: dict[str, KeyPair]

    def tunnel(self, who: str, server_key: str = "") -> Tunnel:
        return Tunnel(self.gateway.address, server_key or self.gateway.public_key, self.pairs[who])


def serve(gateway: Gateway, stack: ExitStack) -> None:
    stop = threading.Event()
    thread = threading.Thread(target=gateway.run, args=(stop,))
    thread.start()

    def end() -> None:
        stop.set()
        thread.join(WALL_CLOCK_S)
        gateway.close()

    stack.callback(end)


@pytest.fixture
def far(run_dir: Path, tmp_path: Path) -> Iterator[Far]:
    pairs = {name: make_pair(tmp_path / f"{name}.key") for name in ("ann", "watcher", "stranger")}
    make_pair(tmp_path / "server.key")
    allow(tmp_path, "ann", pairs["ann"].public, "steer")
    allow(tmp_path, "watcher", pairs["watcher"].public, "watch")
    with ExitStack() as stack:
        daemon = stack.enter_context(FakeDaemon(run_dir))
        gateway = Gateway(NetworkConfig(host="127.0.0.1", port=free_port(len(OFFERED))), run_dir, tmp_path)
        serve(gateway, stack)
        yield Far(gateway, daemon, tmp_path, pairs)


def test_the_right_key_hears_and_steers(far: Far) -> None:
    far.daemon.progress = PROGRESS
    with far.tunnel("ann") as tunnel:
        tunnel.wait(WALL_CLOCK_S)
        feed = ProgressFeed(tunnel.run_dir)
        with RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
            assert client.status().state == "idle"
            assert client.request("scan", name="ear").result["scan_uid"] == "uid-ear"
        wait_for(lambda: feed.newest() == PROGRESS or feed.newest() is not None, "progress")
        feed.close()
    assert far.daemon.commands == [("scan", {"name": "ear"})]


def test_an_unknown_key_is_refused_in_words_and_hears_nothing(far: Far) -> None:
    with far.tunnel("stranger") as tunnel:
        with pytest.raises(NoServiceError, match="does not know this key"):
            tunnel.wait(WALL_CLOCK_S)
        with RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
            assert client.newest_status(0.3) is None
            with pytest.raises(CommandRefusedError, match="does not know this key"):
                client.request("stop")
    assert far.daemon.commands == []


def test_a_client_that_takes_another_for_the_rig_tells_it_nothing(far: Far) -> None:
    refused = pytest.raises(NoServiceError, match="--server-key")
    with far.tunnel("ann", server_key=far.pairs["stranger"].public) as tunnel, refused:
        tunnel.wait(WALL_CLOCK_S)


def test_a_key_that_may_only_watch_hears_and_does_not_steer(far: Far) -> None:
    with far.tunnel("watcher") as tunnel:
        tunnel.wait(WALL_CLOCK_S)
        with RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
            assert client.status().state == "idle"
            for name in ("scan", "stop", "goto"):
                with pytest.raises(CommandRefusedError, match="may watch the rig, not steer it"):
                    client.request(name)
    assert far.daemon.commands == []


def plain(context: zmq.Context, kind: int, endpoint: str) -> zmq.Socket:
    knock = context.socket(kind)
    knock.setsockopt(zmq.LINGER, 0)
    if kind == zmq.SUB:
        knock.setsockopt(zmq.SUBSCRIBE, b"")
    knock.connect(endpoint)
    return knock


def test_without_any_key_no_lane_answers(far: Far) -> None:
    far.daemon.progress = PROGRESS
    with zmq.Context() as context, ExitStack() as stack:
        ears = [stack.enter_context(plain(context, zmq.SUB, far.gateway.address.endpoint(lane))) for lane in SPOKEN]
        mouth = stack.enter_context(plain(context, zmq.DEALER, far.gateway.address.endpoint("command")))
        mouth.send(b"stop")
        with far.tunnel("ann") as tunnel:  # somebody with a key is let in meanwhile, and hears
            tunnel.wait(WALL_CLOCK_S)
        assert [ear.poll(0) for ear in (*ears, mouth)] == [0] * 4
    assert far.daemon.commands == []


def test_a_key_that_is_revoked_is_cut_off_at_once_and_may_come_back(far: Far) -> None:
    with far.tunnel("ann") as tunnel, RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
        tunnel.wait(WALL_CLOCK_S)
        client.status()
        revoke(far.folder, "ann")
        wait_for(lambda: client.newest_status(0.3) is None, "silence")
        with pytest.raises(CommandRefusedError):
            client.request("pause")
        assert far.daemon.commands == []
    allow(far.folder, "ann", far.pairs["ann"].public, "steer")
    wait_for(lambda: far.pairs["ann"].public in far.gateway.guard.by_key, "the list is read")
    with far.tunnel("ann") as tunnel:
        tunnel.wait(WALL_CLOCK_S)


def test_a_list_that_cannot_be_read_lets_nobody_in(far: Far) -> None:
    (far.folder / "allowed.toml").write_text("[ann")
    wait_for(lambda: not far.gateway.guard.by_key, "nobody is let in")
    with far.tunnel("ann") as tunnel, pytest.raises(NoServiceError, match="does not know this key"):
        tunnel.wait(WALL_CLOCK_S)


def test_who_holds_control_from_far_away_knows_itself_and_others_know_the_key(far: Far) -> None:
    mine = "anna on pts/3"
    far.daemon.show(control=mine + signature_of(far.pairs["ann"].public))
    with far.tunnel("ann") as tunnel, RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
        tunnel.wait(WALL_CLOCK_S)
        assert client.status().control == mine
    with far.tunnel("watcher") as tunnel, RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
        tunnel.wait(WALL_CLOCK_S)
        assert client.status().control.startswith(f"{mine} via key ")


def test_shutting_down_is_not_taken_from_another_machine(far: Far) -> None:
    with far.tunnel("ann") as tunnel, RigClient(tunnel.run_dir, timeout_s=DEADLINE_S) as client:
        tunnel.wait(WALL_CLOCK_S)
        with pytest.raises(CommandRefusedError, match="not taken from another machine"):
            client.request("shutdown")
    assert far.daemon.commands == []


def test_commands_carry_the_rigs_clock_and_the_name_of_the_key(run_dir: Path, tmp_path: Path) -> None:
    """Two machines have two monotonic clocks; a command that lay in a queue must look as old as it is."""
    ann = make_pair(tmp_path / "ann.key")
    make_pair(tmp_path / "server.key")
    allow(tmp_path, "ann", ann.public, "steer")
    far_ns, old_ns = 10**15, 60 * 10**9
    with ExitStack() as stack:
        context = stack.enter_context(zmq.Context())
        status = stack.enter_context(bind(context, zmq.PUB, run_dir, "status"))
        commands = stack.enter_context(bind(context, zmq.ROUTER, run_dir, "command"))
        gateway = Gateway(NetworkConfig(host="127.0.0.1", port=free_port(len(OFFERED))), run_dir, tmp_path)
        serve(gateway, stack)
        tunnel = stack.enter_context(Tunnel(gateway.address, gateway.public_key, ann))
        passed_on = stack.enter_context(connect(context, zmq.SUB, tunnel.run_dir, "status"))
        before_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
        wait_for(lambda: _say(status, far_ns) or receive(passed_on) is not None, "a status came through the tunnel")
        tunnel.wait(WALL_CLOCK_S)
        mine = stack.enter_context(connect(context, zmq.DEALER, tunnel.run_dir, "command"))
        sent_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC) - old_ns
        mine.send(_encoded(Command(request_id="r1", name="goto", client="anna on pts/3", sent_mono_ns=sent_ns)))
        assert commands.poll(WALL_CLOCK_S * 1000)
        taken = receive(commands)
        after_ns = time.clock_gettime_ns(time.CLOCK_MONOTONIC)  # the last status came between before and after
        assert taken is not None and isinstance(taken.message, Command)
        assert sent_ns - after_ns <= taken.message.sent_mono_ns - far_ns <= sent_ns - before_ns
        assert taken.message.client == f"anna on pts/3{signature_of(ann.public)}"


def _encoded(message: Command | Status) -> bytes:
    from acquire.contract.messaging.codec import encode

    return encode(message)


def _say(status: zmq.Socket, far_ns: int) -> None:
    status.send(_encoded(Status(state="idle", sent_mono_ns=far_ns)))


def test_a_gateway_without_a_key_does_not_begin(run_dir: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="keys make --server"):
        Gateway(NetworkConfig(host="127.0.0.1", port=free_port(len(OFFERED))), run_dir, tmp_path)


def test_an_address_that_is_not_ours_is_told(run_dir: Path, tmp_path: Path) -> None:
    make_pair(tmp_path / "server.key")
    with pytest.raises(ConfigError, match="network.host"):
        Gateway(NetworkConfig(host="192.0.2.1", port=free_port(len(OFFERED))), run_dir, tmp_path)


def test_nobody_at_the_address_is_told_in_time(tmp_path: Path) -> None:
    pair = make_pair(tmp_path / "ann.key")
    refused = pytest.raises(NoServiceError, match="nobody answers")
    with Tunnel(Address("127.0.0.1", free_port(len(OFFERED))), pair.public, pair) as tunnel, refused:
        tunnel.wait(0.3)


def test_the_command_line_steers_a_rig_far_away(far: Far, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--connect", str(far.gateway.address), "--server-key", far.gateway.public_key]
    assert run(["pause", *words, "--key", str(far.folder / "ann.key")]) == 0
    assert run(["pause", *words, "--key", str(far.folder / "watcher.key")]) == 1
    assert run(["pause", *words, "--key", str(far.folder / "stranger.key")]) == 3
    assert [name for name, _ in far.daemon.commands] == ["pause"]
    said = capsys.readouterr().err
    assert "may watch" in said
    assert "does not know this key" in said
