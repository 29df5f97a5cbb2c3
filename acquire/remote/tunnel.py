"""The client's end of remote access: the sockets of a remote rig in a local folder, for any client program.

A command is stamped with the rig's clock so that it expires in time, and is refused while the rig is not connected.
"""

from __future__ import annotations

import shutil
import threading
from collections import Counter
from collections.abc import Callable
from typing import Any, Self

import msgspec
import zmq
from zmq.utils.monitor import parse_monitor_message

from acquire.contract.errors import CommandRefusedError, NoServiceError, ProtocolError
from acquire.contract.messaging.codec import decode_as, encode
from acquire.contract.messaging.lanes import bind, open_socket
from acquire.contract.messaging.messages import Command, Status
from acquire.contract.permissions import never_late
from acquire.contract.process.clocks import mono_ns
from acquire.contract.process.run_dir import temporary_run_dir

from .addresses import ASKED, SPOKEN, Address
from .gateway import keep_alive
from .keys import KeyPair, signature_of
from .relay import Ends, Relay

POLL_MS = 50
PROOF = 3
"""Handshakes that were cut off in a row until we believe that the key is wrong."""
_REFUSED = "the rig does not know this key: 'sweepscope keys allow NAME KEY' at the rig lets it in"
_FAILED = "the rig cannot read what we say: is --server-key the key of this rig ('sweepscope keys list' there)?"
_WATCH_ONLY = "this key may watch the rig, not steer it: 'sweepscope keys allow' at the rig changes that"


class Tunnel:
    """Use it in a ``with`` block; clients connect to the sockets in :attr:`run_dir`."""

    def __init__(
        self,
        address: Address,
        server_key: str,
        pair: KeyPair,
        now_ns: Callable[[], int] = mono_ns,
    ) -> None:
        """Connects on entering the ``with`` block."""
        self.address = address
        self._server_key, self._pair, self._now_ns = server_key, pair, now_ns
        self._signature = signature_of(pair.public)
        self._why: dict[str, str] = {}
        self._cut_off: Counter[str] = Counter()
        self._up: set[str] = set()
        self._ahead_ns: int | None = None
        self._changed = threading.Condition()
        self._ending = threading.Event()

    def __enter__(self) -> Self:
        self.run_dir = temporary_run_dir()
        self._context: zmq.Context[Any] = zmq.Context()
        self._monitors: dict[str, zmq.Socket[Any]] = {}
        self._relay = self._open()
        self._thread = threading.Thread(target=self._run, name="tunnel", daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.set()
        self._thread.join(5)
        for monitor in self._monitors.values():
            monitor.close(0)
        self._relay.close()
        self._context.destroy(linger=0)
        shutil.rmtree(self.run_dir, ignore_errors=True)

    def wait(self, timeout_s: float) -> None:
        """Wait until the rig's status arrives and the command socket is connected, or refused.

        Raises:
            NoServiceError: not connected; the text says why.
        """

        def settled() -> bool:
            return self._ahead_ns is not None and (ASKED in self._up or ASKED in self._why)

        with self._changed:
            heard = self._changed.wait_for(lambda: settled() or self._why.get(SPOKEN[0]) is not None, timeout_s)
            why = self._why.get(SPOKEN[0])
            if why is not None:
                raise NoServiceError(f"{self.address}: {why}")
            if not heard and self._ahead_ns is None:
                up = SPOKEN[0] in self._up
                what = "the gateway lets us in, but no daemon speaks behind it" if up else "nobody answers"
                raise NoServiceError(f"{self.address}: {what} within {timeout_s:g} s; is the rig on, and its gateway?")

    # ---- the thread ----

    def _run(self) -> None:
        while not self._ending.is_set():
            self._relay.turn(POLL_MS)
            for lane, monitor in self._monitors.items():
                while monitor.poll(0):
                    self._take_event(lane, parse_monitor_message(monitor.recv_multipart())["event"])

    def _take_event(self, lane: str, event: int) -> None:
        with self._changed:
            if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
                self._up.add(lane)
                self._cut_off[lane] = 0
                self._why.pop(lane, None)
            elif event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self._why[lane] = _REFUSED
            elif event in (zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL, zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL):
                # a restarting gateway also breaks a handshake; one with another key breaks every one
                self._cut_off[lane] += 1
                if self._cut_off[lane] >= PROOF:
                    self._why[lane] = _FAILED
            elif event == zmq.EVENT_DISCONNECTED:
                self._up.discard(lane)
            self._changed.notify_all()

    def _listen(self, lane: str, parts: list[zmq.Frame]) -> list[Any]:
        if lane != "status":
            return parts
        try:
            status = decode_as(parts[0].buffer, Status)
        except ProtocolError:
            return parts
        with self._changed:
            # a late status makes our commands look older than they are, never younger
            self._ahead_ns = status.sent_mono_ns - self._now_ns()
            self._changed.notify_all()
        if not status.control.endswith(self._signature):
            return parts
        # the holder of control behind this tunnel knows itself by its own name
        return [encode(msgspec.structs.replace(status, control=status.control.removesuffix(self._signature)))]

    def _judge(self, command: Command, _who: str) -> Command:
        if self._why.get(ASKED) == _REFUSED:
            raise CommandRefusedError(_REFUSED if SPOKEN[0] in self._why else _WATCH_ONLY)
        if self._ahead_ns is None and not never_late(command.name):
            raise CommandRefusedError("not sent: the rig has not been heard yet")
        stamp = max(1, command.sent_mono_ns + (self._ahead_ns or 0))
        return msgspec.structs.replace(command, sent_mono_ns=stamp)

    # ---- sockets ----

    def _open(self) -> Relay:
        fronts = {lane: bind(self._context, zmq.XPUB, self.run_dir, lane) for lane in SPOKEN}
        for front in fronts.values():
            front.setsockopt(zmq.XPUB_VERBOSE, 1)
        spoken = {lane: Ends(front, self._back(zmq.XSUB, lane)) for lane, front in fronts.items()}
        # the rig's clock is needed even without a subscriber
        spoken["status"].back.send(b"\x01")
        asked = Ends(bind(self._context, zmq.ROUTER, self.run_dir, ASKED), self._back(zmq.DEALER, ASKED))
        return Relay(spoken, asked, self._judge, self._listen)

    def _back(self, kind: int, lane: str) -> zmq.Socket[Any]:
        socket = open_socket(self._context, kind, lane)
        socket.setsockopt(zmq.CURVE_SERVERKEY, self._server_key.encode())
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self._pair.public.encode())
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._pair.secret.encode())
        socket.setsockopt(zmq.IPV6, int(":" in self.address.host))
        socket.setsockopt(zmq.RECONNECT_IVL, 100)
        socket.setsockopt(zmq.RECONNECT_IVL_MAX, 2000)
        keep_alive(socket)
        if kind == zmq.DEALER:
            socket.setsockopt(zmq.IMMEDIATE, 1)
        self._monitors[lane] = socket.get_monitor_socket()
        socket.connect(self.address.endpoint(lane))
        return socket
