"""Puts the guard in front of viser's web server, and proves at start-up that it stands there.

viser has no hook for this. Its server is made by ``websockets.asyncio.server.serve``; while viser is built, that name
is replaced by one that asks the guard first and listens on a socket of ours (so viser cannot slide to another port).
This leans on internals of viser 1.1.1 and websockets 16.1.1: both are pinned, and :func:`prove` refuses to run when
an upgrade has moved the hinge.
"""

from __future__ import annotations

import contextlib
import errno
import http.client
import io
import logging
import socket
from collections.abc import Callable, Iterator, MutableMapping
from http import HTTPStatus
from typing import Any

import viser
import websockets.asyncio.server
import websockets.exceptions
import websockets.sync.client
from viser import _messages
from websockets import Headers
from websockets.http11 import Request, Response

from acquire.contract.errors import ConfigError, SweepscopeError

from .access_control import Gate, Verdict, Visit
from .connection import Meter, metered

MAX_UPLOAD_BYTES = 1024 * 1024
"""Largest message taken from a browser; ours are clicks and camera poses."""
DEFAULT_BYTES_PER_S = 16_000_000.0
PROOF_TIMEOUT_S = 10.0
_EVIL = "https://evil.example"

_log = logging.getLogger("sweepscope.viewer.door")
# a port scan or a dropped connection is no news; refusals are counted by the gate
_log.setLevel(logging.CRITICAL)


class GuardError(SweepscopeError):
    """The page would be open to foreign web pages, so it is not served."""


class Page(viser.ViserServer):
    """viser's server without its way to publish the page through a tunnel."""

    meters: MutableMapping[Any, Meter]
    """What each connection was sent."""

    def meter_of(self, client_id: int) -> Meter | None:
        """The meter of one browser; None once it is gone."""
        connection = self._websock_server._live_connections.get(client_id)
        return self.meters.get(connection) if connection is not None else None

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Refused: the page stays on this machine."""
        del verbose
        return None


def listen(host: str, port: int) -> socket.socket:
    """A listening TCP socket on ``host``; port 0 takes any free one.

    Raises:
        ConfigError: the port is taken, or the address is not this machine's.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)[0][0]
        return socket.create_server((host, port), family=family)
    except OSError as error:
        why = "the port is taken" if error.errno == errno.EADDRINUSE else error.strerror
        raise ConfigError(
            f"cannot serve the viewer on {host}:{port}: {why}; nothing is touched; stop the other program, "
            "or set viewer.port (0 takes any free one)"
        ) from None


def open_page(
    gate: Gate, listener: socket.socket, label: str = "sweepscope", max_bytes_per_s: float = DEFAULT_BYTES_PER_S
) -> Page:
    """A page behind the gate, proven to refuse strangers; nobody is let in before :meth:`Gate.arm`.

    Raises:
        GuardError: the guard is not in front of the page, or lets a stranger in.
    """
    meters: MutableMapping[Any, Meter] = {}
    with _guarded_serve(gate, listener, meters, max_bytes_per_s) as used, _quiet():
        page = Page(host=gate.bound_host, port=listener.getsockname()[1], label=label, verbose=False)
    page.meters = meters
    try:
        if not used:
            raise GuardError("this version of viser cannot be guarded: install the pinned viser and websockets")
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            page._websock_server.unregister_handler(message)
        prove(gate, listener.getsockname())
    except (AssertionError, AttributeError) as error:
        close_page(page)
        raise GuardError(f"viser has changed inside ({error}): install the pinned viser and websockets") from None
    except GuardError:
        close_page(page)
        raise
    return page


def close_page(page: Page) -> None:
    """Stop the server and its threads."""
    with _quiet():
        page.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """viser prints an address without the token, which nobody could use."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


@contextlib.contextmanager
def _guarded_serve(
    gate: Gate, listener: socket.socket, meters: MutableMapping[Any, Meter], max_bytes_per_s: float
) -> Iterator[list[socket.socket]]:
    original = websockets.asyncio.server.serve
    used: list[socket.socket] = []

    def serve(handler: Any, host: object, port: object, **options: Any) -> Any:
        del host, port
        used.append(listener)
        options["process_request"] = _ask_first(gate, options.get("process_request"))
        options |= {"max_size": MAX_UPLOAD_BYTES, "server_header": None, "logger": _log}
        return original(metered(handler, meters, max_bytes_per_s), sock=listener, **options)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield used
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


def _ask_first(gate: Gate, inner: Callable[[Any, Request], Response | None] | None) -> Callable[..., Response | None]:
    def process_request(connection: Any, request: Request) -> Response | None:
        verdict = gate.decide(visit_of(request))
        if not verdict.passes:
            return _response(verdict)
        response = inner(connection, request) if inner is not None else None
        if response is not None:
            _harden(response, request.headers.get("Host", ""))
        return response

    return process_request


def visit_of(request: Request) -> Visit:
    """What the guard has to know of a request."""
    headers = request.headers
    return Visit(
        target=request.path,
        hosts=tuple(headers.get_all("Host")),
        origins=tuple(headers.get_all("Origin")),
        cookies=tuple(headers.get_all("Cookie")),
        upgrade=bool(headers.get_all("Upgrade") or headers.get_all("Sec-WebSocket-Key")),
    )


def _response(verdict: Verdict) -> Response:
    body = verdict.text.encode()
    kind = "text/html" if verdict.text.startswith("<!doctype") else "text/plain"
    headers = Headers()
    headers["Content-Type"] = f"{kind}; charset=utf-8"
    headers["Content-Length"] = str(len(body))
    headers["Connection"] = "close"
    if verdict.location:
        headers["Location"] = verdict.location
    if verdict.cookie:
        headers["Set-Cookie"] = verdict.cookie
    response = Response(verdict.status.value, verdict.status.phrase, headers, body)
    _harden(response, "")
    return response


def _harden(response: Response, host: str) -> None:
    """No framing by others, no cache, no outside requests, and a websocket to nowhere but here."""
    sockets = f"ws://{host} wss://{host}" if host else ""
    response.headers["Content-Security-Policy"] = (
        "default-src 'self' 'unsafe-inline' 'unsafe-eval' data: blob:; worker-src 'self' blob: data:; "
        f"connect-src 'self' data: blob: {sockets}; frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
    )
    response.headers["X-Frame-Options"] = "DENY"
    response.headers["X-Content-Type-Options"] = "nosniff"
    response.headers["Referrer-Policy"] = "no-referrer"
    response.headers["Cache-Control"] = "no-store"


def prove(gate: Gate, address: tuple[Any, ...]) -> None:
    """Knock as a stranger and as the own page, before the gate is armed.

    Raises:
        GuardError: a stranger was let in, or the own page would not be.
    """
    host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(address[0], address[0])  # noqa: S104 - compared, not bound
    authority = f"[{host}]:{address[1]}" if ":" in host else f"{host}:{address[1]}"
    own = f"http://{authority}"
    knocks = (
        ("a foreign page", _knock(authority, _EVIL, gate.cookie), HTTPStatus.FORBIDDEN),
        ("a page without origin", _knock(authority, "null", gate.cookie), HTTPStatus.FORBIDDEN),
        ("a visitor without the cookie", _knock(authority, own, None), HTTPStatus.UNAUTHORIZED),
        ("the own page", _knock(authority, own, gate.cookie), HTTPStatus.SERVICE_UNAVAILABLE),
    )
    for who, got, wanted in knocks:
        if got != wanted:
            raise GuardError(
                f"the viewer is not served: its guard answered {got or 'with an open door'} to {who}, not {wanted}; "
                "install the pinned viser and websockets"
            )


def _knock(authority: str, origin: str, cookie: str | None) -> int:
    """The HTTP status that a websocket request gets; 0 if it was accepted."""
    try:
        with websockets.sync.client.connect(
            f"ws://{authority}/",
            origin=origin,  # type: ignore[arg-type]
            additional_headers={"Cookie": cookie} if cookie else None,
            proxy=None,
            open_timeout=PROOF_TIMEOUT_S,
            close_timeout=1,
        ):
            return 0
    except websockets.exceptions.InvalidStatus as error:
        return error.response.status_code
    except (OSError, websockets.exceptions.WebSocketException, http.client.HTTPException) as error:
        raise GuardError(f"the viewer's page does not answer on {authority}: {error}") from None
