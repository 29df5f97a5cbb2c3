"""Decides for each HTTP request whether it comes from the operator's own page.

The page moves hardware, and a browser lets any web site talk to loopback. So a request passes only if its Host is a
name of this machine (DNS rebinding arrives with another), its Origin, where there is one, equals its Host (a foreign
page arrives with its own), and it has the cookie that the token in the printed address was exchanged for.
"""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
import secrets
import socket
import threading
from collections import Counter
from dataclasses import dataclass, field
from http import HTTPStatus
from urllib.parse import parse_qs, urlsplit

MAX_HEADER_TEXT = 4096
"""Longer Host, Origin or Cookie headers are refused unread."""
HELP_PAGE = """<!doctype html><meta charset="utf-8"><title>sweepscope</title>
<body style="font:16px/1.5 system-ui,sans-serif;max-width:38em;margin:4em auto;padding:0 1em">
<h1 style="font-size:1.3em">This page needs its full address</h1>
<p>Open the address that ends in <code>/?token=&hellip;</code>. The viewer prints it when it starts; it also stands in
the file <code>viewer.url</code> beside the sockets, and in the header of the console.</p>
<p>If you have just followed such an address from another page, <a href="/">go on here</a>.</p>"""


@dataclass(frozen=True)
class PageRequest:
    """What of one HTTP request is judged; headers may come several times, hence the tuples."""

    target: str
    """Path and query as sent."""
    hosts: tuple[str, ...] = ()
    origins: tuple[str, ...] = ()
    cookies: tuple[str, ...] = ()
    upgrade: bool = False
    """True for a request that wants to become a websocket."""


@dataclass(frozen=True)
class AccessDecision:
    """The request may pass, or this is the response."""

    status: HTTPStatus
    text: str = ""
    location: str = ""
    cookie: str = ""

    @property
    def passes(self) -> bool:
        """True if the request may go on to the page."""
        return self.status is HTTPStatus.OK


PASS = AccessDecision(HTTPStatus.OK)


def is_loopback(host: str) -> bool:
    """True if ``host`` (a name or an address, without port) can only be reached from this machine."""
    if host.lower() == "localhost":
        return True
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return False


def host_name(authority: str) -> str | None:
    """The name in a Host header, lower case, without its port; None if it is malformed."""
    try:
        parts = urlsplit(f"//{authority}")
        parts.port  # noqa: B018 - raises ValueError on a port that is no number
    except ValueError:
        return None
    if parts.path or parts.query or parts.fragment or parts.username is not None or not parts.hostname:
        return None
    return parts.hostname.lower()


def _own_names(bound_host: str) -> frozenset[str]:
    """Names that may stand in Host when the page is bound to more than loopback."""
    machine = socket.gethostname().lower()
    return frozenset({machine, f"{machine}.local", socket.getfqdn().lower(), bound_host.lower()})


def _is_address(host: str) -> bool:
    try:
        ipaddress.ip_address(host)
    except ValueError:
        return False
    return True


@dataclass
class AccessControl:
    """The secrets of one running page, and the rules by which requests are judged.

    The port in Host is not compared with ours: ``ssh -L`` maps ports, and Origin must repeat whatever Host says.
    """

    bound_host: str = "127.0.0.1"
    token: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    """Stands in the printed address."""
    session: str = field(default_factory=lambda: secrets.token_urlsafe(32))
    """Stands in the cookie; another secret than the token, so that an address in a history is not the cookie."""
    refused: Counter[str] = field(default_factory=Counter)
    """Refused requests by reason."""
    _armed: threading.Event = field(default_factory=threading.Event)

    @property
    def view_only(self) -> bool:
        """True if others than this machine can reach the page: then it shows no controls."""
        return not is_loopback(self.bound_host)

    @property
    def cookie_name(self) -> str:
        """Cookies are shared by all ports of a host: each page needs a name of its own."""
        return f"sweepscope_{hashlib.sha256(self.session.encode()).hexdigest()[:12]}"

    @property
    def cookie(self) -> str:
        """The Cookie header of a browser that may come in."""
        return f"{self.cookie_name}={self.session}"

    def authority(self, port: int) -> str:
        """Host and port under which this machine reaches the page."""
        host = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.bound_host, self.bound_host)  # noqa: S104 - not bound
        return f"[{host}]:{port}" if ":" in host else f"{host}:{port}"

    def arm(self) -> None:
        """Let requests pass; before this even the own page gets 503, so that no browser shows a half-built page."""
        self._armed.set()

    def decide(self, request: PageRequest) -> AccessDecision:
        """403 wrong Host or Origin, 401 no cookie or wrong token, 302 token exchanged, 503 not ready, else pass."""
        refusal = self._wrong_place(request) or self._exchange(request) or self._without_cookie(request)
        if refusal is None and not self._armed.is_set():
            refusal = AccessDecision(HTTPStatus.SERVICE_UNAVAILABLE, "The page is being built; try again.\n")
        if refusal is None and urlsplit(request.target).query and not request.upgrade:
            # the page's own code obeys query parameters: ?websocket= would connect it to a foreign server
            refusal = AccessDecision(HTTPStatus.FOUND, location="/")
        return refusal or PASS

    def _refuse(self, status: HTTPStatus, reason: str, text: str) -> AccessDecision:
        self.refused[reason] += 1
        return AccessDecision(status, text)

    def _wrong_place(self, request: PageRequest) -> AccessDecision | None:
        if any(len(text) > MAX_HEADER_TEXT for text in (*request.hosts, *request.origins, *request.cookies)):
            return self._refuse(HTTPStatus.FORBIDDEN, "size", "A header is too long.\n")
        if len(request.hosts) != 1 or not self._host_is_ours(request.hosts[0]):
            return self._refuse(HTTPStatus.FORBIDDEN, "host", "This name is not a name of the rig.\n")
        if len(request.origins) > 1 or (request.upgrade and not request.origins):
            return self._refuse(HTTPStatus.FORBIDDEN, "origin", "The request does not say where it comes from.\n")
        own = {f"{scheme}://{request.hosts[0].lower()}" for scheme in ("http", "https")}
        if request.origins and request.origins[0].lower() not in own:
            return self._refuse(HTTPStatus.FORBIDDEN, "origin", "The request comes from another page.\n")
        return None

    def _host_is_ours(self, authority: str) -> bool:
        name = host_name(authority)
        if name is None:
            return False
        if is_loopback(name):
            return True
        # a bare address cannot be rebound to another machine, a name can
        return self.view_only and (_is_address(name) or name in _own_names(self.bound_host))

    def _exchange(self, request: PageRequest) -> AccessDecision | None:
        tokens = parse_qs(urlsplit(request.target).query).get("token", [])
        if request.upgrade or not tokens:
            return None
        if len(tokens) != 1 or not hmac.compare_digest(tokens[0].encode(), self.token.encode()):
            return self._refuse(HTTPStatus.UNAUTHORIZED, "token", HELP_PAGE)
        cookie = f"{self.cookie}; Path=/; HttpOnly; SameSite=Strict"
        return AccessDecision(HTTPStatus.FOUND, location="/", cookie=cookie)

    def _without_cookie(self, request: PageRequest) -> AccessDecision | None:
        wanted = self.cookie.encode()
        sent = (part.strip().encode() for header in request.cookies for part in header.split(";"))
        if any([hmac.compare_digest(part, wanted) for part in sent]):  # noqa: C419 - looks at all, in constant time
            return None
        return self._refuse(HTTPStatus.UNAUTHORIZED, "cookie", HELP_PAGE)
