"""viser's web server behind access control; at start-up it is checked that strangers are refused.

viser has no hook for this. Its server is made by ``websockets.asyncio.server.serve``; while viser is built, that name
is replaced by a function that judges each request and listens on a socket of ours (viser would take the next port if
one is taken). This depends on internals of viser 1.1.1 and websockets 16.1.1: both are pinned, and
:func:`check_guard` lets nothing be served when an upgrade has changed them.
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

from .access_control import AccessControl, AccessDecision, PageRequest
from .rate_meter import RateMeter, metered

MAX_UPLOAD_BYTES = 1024 * 1024
"""Largest message taken from a browser; ours are clicks and camera poses."""
DEFAULT_BYTES_PER_S = 16_000_000.0
CHECK_TIMEOUT_S = 10.0
FOREIGN_ORIGIN = "https://evil.example"
_WHAT_TO_DO = "install the pinned viser and websockets"

_log = logging.getLogger("sweepscope.viewer.server")
# port scans and dropped connections would fill the log; refusals are counted
_log.setLevel(logging.CRITICAL)


class AccessControlError(SweepscopeError):
    """The page would be open to foreign web pages, so it is not served."""


class GuardedServer(viser.ViserServer):
    """viser's server without its way to publish the page through a tunnel."""

    meters: MutableMapping[Any, RateMeter]
    """By connection."""

    def meter_of(self, client_id: int) -> RateMeter | None:
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


def start_server(
    access: AccessControl, listener: socket.socket, max_bytes_per_s: float = DEFAULT_BYTES_PER_S
) -> GuardedServer:
    """A server that has been checked to refuse strangers; no browser is let in before :meth:`AccessControl.arm`.

    Raises:
        AccessControlError: requests are not judged, or a stranger was let in.
    """
    meters: MutableMapping[Any, RateMeter] = {}
    port = listener.getsockname()[1]
    with _guarded_serve(access, listener, meters, max_bytes_per_s) as used, _quiet():
        server = GuardedServer(host=access.bound_host, port=port, label="sweepscope", verbose=False)
    server.meters = meters
    try:
        if not used:
            raise AccessControlError(f"this version of viser cannot be guarded: {_WHAT_TO_DO}")
        for message in (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect):
            server._websock_server.unregister_handler(message)
        check_guard(access, port)
    except (AssertionError, AttributeError) as error:
        stop_server(server)
        raise AccessControlError(f"viser has changed inside ({error}): {_WHAT_TO_DO}") from None
    except AccessControlError:
        stop_server(server)
        raise
    return server


def stop_server(server: GuardedServer) -> None:
    """Stop the server and its threads."""
    with _quiet():
        server.stop()


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """viser prints an address without the token, which is of no use."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield


@contextlib.contextmanager
def _guarded_serve(
    access: AccessControl, listener: socket.socket, meters: MutableMapping[Any, RateMeter], max_bytes_per_s: float
) -> Iterator[list[socket.socket]]:
    """While this lasts, a websocket server that is made is ours; the list is empty if none was made."""
    original = websockets.asyncio.server.serve
    used: list[socket.socket] = []

    def serve(handler: Any, host: object, port: object, **options: Any) -> Any:
        del host, port
        used.append(listener)
        options["process_request"] = _judging(access, options.get("process_request"))
        options |= {"max_size": MAX_UPLOAD_BYTES, "server_header": None, "logger": _log}
        return original(metered(handler, meters, max_bytes_per_s), sock=listener, **options)

    websockets.asyncio.server.serve = serve  # type: ignore[assignment,misc]
    try:
        yield used
    finally:
        websockets.asyncio.server.serve = original  # type: ignore[misc]


def _judging(
    access: AccessControl, inner: Callable[[Any, Request], Response | None] | None
) -> Callable[..., Response | None]:
    """``inner``, viser's own handler of requests, for those that may pass."""

    def process_request(connection: Any, request: Request) -> Response | None:
        decision = access.decide(request_of(request))
        if not decision.passes:
            return _response(decision)
        response = inner(connection, request) if inner is not None else None
        if response is not None:
            _harden(response, request.headers.get("Host", ""))
        return response

    return process_request


def request_of(request: Request) -> PageRequest:
    """What of a request is judged."""
    headers = request.headers
    return PageRequest(
        target=request.path,
        hosts=tuple(headers.get_all("Host")),
        origins=tuple(headers.get_all("Origin")),
        cookies=tuple(headers.get_all("Cookie")),
        upgrade=bool(headers.get_all("Upgrade") or headers.get_all("Sec-WebSocket-Key")),
    )


def _response(decision: AccessDecision) -> Response:
    body = decision.text.encode()
    kind = "text/html" if decision.text.startswith("<!doctype") else "text/plain"
    headers = {"Content-Type": f"{kind}; charset=utf-8", "Content-Length": str(len(body)), "Connection": "close"}
    if decision.location:
        headers["Location"] = decision.location
    if decision.cookie:
        headers["Set-Cookie"] = decision.cookie
    response = Response(decision.status.value, decision.status.phrase, Headers(headers), body)
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


def check_guard(access: AccessControl, port: int) -> None:
    """Try to open a websocket as strangers and as the own page; ``access`` must not be armed yet.

    Raises:
        AccessControlError: a stranger was let in, or the own page would not be.
    """
    authority = access.authority(port)
    own = f"http://{authority}"
    for who, origin, cookie, wanted in (
        ("a foreign page", FOREIGN_ORIGIN, access.cookie, HTTPStatus.FORBIDDEN),
        ("a page without origin", "null", access.cookie, HTTPStatus.FORBIDDEN),
        ("a visitor without the cookie", own, None, HTTPStatus.UNAUTHORIZED),
        ("the own page", own, access.cookie, HTTPStatus.SERVICE_UNAVAILABLE),
    ):
        got = _open_websocket(authority, origin, cookie)
        if got != wanted:
            raise AccessControlError(
                f"the viewer is not served: its guard answered {got or 'with an open door'} to {who}, not {wanted}; "
                f"{_WHAT_TO_DO}"
            )


def _open_websocket(authority: str, origin: str, cookie: str | None) -> int:
    """The HTTP status that a websocket request gets; 0 if it was accepted."""
    try:
        with websockets.sync.client.connect(
            f"ws://{authority}/",
            origin=origin,  # type: ignore[arg-type]
            additional_headers={"Cookie": cookie} if cookie else None,
            proxy=None,
            open_timeout=CHECK_TIMEOUT_S,
            close_timeout=1,
        ):
            return 0
    except websockets.exceptions.InvalidStatus as error:
        return error.response.status_code
    except (OSError, websockets.exceptions.WebSocketException, http.client.HTTPException) as error:
        raise AccessControlError(f"the viewer's page does not answer on {authority}: {error}") from None
