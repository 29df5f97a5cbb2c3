"""The running page from outside: who comes in, who does not."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Iterator
from typing import Any

import msgspec
import pytest
import viser
import websockets.asyncio.server
import websockets.sync.client
from viser import _messages

from process.viewer.server import guarded_server
from process.viewer.server.access_control import PASS, AccessControl, AccessDecision, PageRequest
from process.viewer.server.guarded_server import AccessControlError, GuardedServer, listen, start_server, stop_server
from tests.fakes.processes.viewer_process import ViewerProcess, request, upgrade


@pytest.fixture(scope="module")
def viewer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ViewerProcess]:
    run = tmp_path_factory.mktemp("run")
    run.chmod(0o700)
    with ViewerProcess(run) as viewer:
        yield viewer


@pytest.fixture
def page() -> Iterator[tuple[AccessControl, GuardedServer, int]]:
    access = AccessControl()
    listener = listen("127.0.0.1", 0)
    page = start_server(access, listener)
    yield access, page, listener.getsockname()[1]
    stop_server(page)


@pytest.mark.shares_processes
@pytest.mark.parametrize(
    ("knock", "status"),
    [
        ({"origin": "https://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"origin": None}, 403),
        ({"origin": "http://evil.example:{port}", "host": "evil.example:{port}"}, 403),
        ({"origin": "http://127.0.0.1:1"}, 403),
        ({"origin": "http://127.0.0.1:{port}", "cookie": None}, 401),
        ({"origin": "http://127.0.0.1:{port}"}, 101),
    ],
)
def test_only_the_own_page_may_open_the_websocket(
    viewer: ViewerProcess, knock: dict[str, str | None], status: int
) -> None:
    fields = {name: text.format(port=viewer.port) if text else None for name, text in knock.items()}
    assert upgrade(viewer.port, **({"cookie": viewer.cookie()} | fields)) == status


@pytest.mark.shares_processes
def test_without_the_cookie_the_page_itself_is_not_served(viewer: ViewerProcess) -> None:
    assert request(viewer.port)[0] == 401
    assert request(viewer.port, "/?token=guess")[0] == 401


@pytest.mark.shares_processes
def test_the_printed_address_opens_the_page_and_the_page_may_not_be_framed(viewer: ViewerProcess) -> None:
    status, headers = request(viewer.port, Cookie=viewer.cookie())
    assert status == 200
    assert headers["x-frame-options"] == "DENY"
    assert "frame-ancestors 'none'" in headers["content-security-policy"]
    assert f"ws://127.0.0.1:{viewer.port} " in headers["content-security-policy"]


@pytest.mark.shares_processes
def test_a_port_mapped_by_a_tunnel_opens_the_page(viewer: ViewerProcess) -> None:
    with tunnel_to(viewer.port) as port:
        status, headers = request(port, f"/?token={viewer.token}", Host=f"localhost:{port}")
        assert status == 302
        cookie = headers["set-cookie"].partition(";")[0]
        assert request(port, Host=f"localhost:{port}", Cookie=cookie)[0] == 200
        here = f"localhost:{port}"
        assert upgrade(port, host=here, origin=f"http://{here}", cookie=cookie) == 101


@contextlib.contextmanager
def tunnel_to(port: int) -> Iterator[int]:
    """What ``ssh -L`` does: another local port leads to ``port``."""
    listener = socket.create_server(("127.0.0.1", 0))
    copiers: list[threading.Thread] = []

    def copy(source: socket.socket, target: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                target.sendall(data)
        for end in (source, target):
            with contextlib.suppress(OSError):
                end.shutdown(socket.SHUT_RDWR)

    def carry(near: socket.socket) -> None:
        with near, socket.create_connection(("127.0.0.1", port)) as far:
            back = threading.Thread(target=copy, args=(far, near))
            back.start()
            copy(near, far)
            back.join(5)

    def accept() -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = listener.accept()
                copiers.append(threading.Thread(target=carry, args=(near,)))
                copiers[-1].start()

    acceptor = threading.Thread(target=accept)
    acceptor.start()
    try:
        yield listener.getsockname()[1]
    finally:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        for thread in (acceptor, *copiers):
            thread.join(5)


def test_a_request_to_share_the_page_with_the_world_does_nothing(
    page: tuple[AccessControl, GuardedServer, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    access, server, port = page
    access.arm()
    asked: list[object] = []
    monkeypatch.setattr(viser.ViserServer, "request_share_url", lambda *_: asked.append("viser"))
    monkeypatch.setattr(GuardedServer, "request_share_url", lambda *_: asked.append("page"))
    there = threading.Event()
    server.on_client_connect(lambda _client: there.set())
    with websockets.sync.client.connect(
        f"ws://127.0.0.1:{port}",
        origin=f"http://127.0.0.1:{port}",
        additional_headers={"Cookie": access.cookie},
        subprotocols=[f"viser-v{viser.__version__}"],
        proxy=None,
        compression=None,
    ) as browser:
        browser.send(msgspec.msgpack.encode({"type": "ShareUrlRequest"}))
        browser.send(msgspec.msgpack.encode(camera_message()))
        # messages are handled in order: once the camera's has arrived, the request for a tunnel is over
        assert there.wait(10)
    assert asked == []
    # viser has no public list of what it obeys
    assert server._websock_server._incoming_handlers.get(_messages.ShareUrlRequest) is None


def camera_message() -> dict[str, Any]:
    """The first message of a browser."""
    return {
        "type": "ViewerCameraMessage",
        "wxyz": (1.0, 0.0, 0.0, 0.0),
        "position": (0.0, 0.0, 5.0),
        "fov": 1.0,
        "near": 0.1,
        "far": 100.0,
        "image_height": 600,
        "image_width": 800,
        "look_at": (0.0, 0.0, 0.0),
        "up_direction": (0.0, 0.0, 1.0),
    }


class OpenDoor(AccessControl):
    """Lets everybody in."""

    def decide(self, request: PageRequest) -> AccessDecision:
        return PASS


def test_a_guard_that_lets_strangers_in_is_found_at_the_start_and_nothing_is_served() -> None:
    listener = listen("127.0.0.1", 0)
    port = listener.getsockname()[1]
    with pytest.raises(AccessControlError, match="open door.* to a foreign page"):
        start_server(OpenDoor(), listener)
    with pytest.raises(ConnectionRefusedError):
        request(port)


def test_a_viser_that_no_longer_asks_for_its_server_by_that_name_is_not_served(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # private, because what is simulated is a viser that this function does not know
    monkeypatch.setattr(guarded_server, "_guarded_serve", lambda *_: contextlib.nullcontext([]))
    with (
        listen("127.0.0.1", 0) as listener,
        pytest.raises(AccessControlError, match="cannot be guarded"),
    ):
        start_server(AccessControl(), listener)


def test_the_library_is_left_as_it_was_after_the_page_is_built(
    page: tuple[AccessControl, GuardedServer, int],
) -> None:
    assert websockets.asyncio.server.serve.__module__ == "websockets.asyncio.server"
