"""The gateway: offers status, results, preview and commands over TCP to clients whose key is allowed.

A separate service: daemon and worker need no network, and its death affects no sweep. Every connection is
encrypted and authenticated (CURVE, with an allow-list behind ZAP); frames and the live lane never leave the machine.
"""

from __future__ import annotations

import logging
import signal
import threading
import time
from pathlib import Path
from typing import Any

import msgspec
import zmq
from zmq.auth.thread import ThreadAuthenticator

from acquire.contract.config.load import LoadedConfig
from acquire.contract.config.model import NetworkConfig
from acquire.contract.errors import CommandRefusedError, ConfigError
from acquire.contract.messaging.lanes import MAX_COMMAND_BYTES, connect, open_socket
from acquire.contract.messaging.messages import Command
from acquire.contract.process.log_throttle import log_throttled
from acquire.contract.process.notify import Notifier
from acquire.contract.process.run_dir import lock_service, prepare_run_dir

from .addresses import ASKED, OFFERED, SPOKEN, Address
from .keys import ALLOWED_NAME, SERVER_KEY_NAME, Allowed, KeyPair, load_allowed, load_pair, rig_folder, signature_of
from .relay import Ends, Relay

logger = logging.getLogger(__name__)
POLL_MS = 100
LOOK_S = 0.5
"""How often the list of allowed keys is looked at."""
REBIND_S = 5.0
"""Closing a listening port takes a moment; it is tried again for so long."""
HEARTBEAT_MS, SILENCE_MS = 1000, 5000
MAX_CLIENT = 100
LOCAL_ONLY = ("shutdown",)
"""Commands that are not taken from another machine."""
_MAKE = "'sudo sweepscope keys make --server' makes it"


class AccessList:
    """Allowed keys; read by the authenticator's thread, replaced as a whole by the gateway's."""

    def __init__(self) -> None:
        self.by_key: dict[str, tuple[str, Allowed]] = {}
        self.refused = 0

    def callback(self, domain: str, key: bytes) -> bool:
        """ZAP callback: may a client with this ``key`` (Z85) use the sockets of this domain?"""
        found = self.by_key.get(key.decode("ascii", "replace"))
        if found is not None and (domain == "watch" or found[1].may == "steer"):
            return True
        self.refused += 1
        who = found[0] if found else "an unknown key"
        log_throttled(logger, self.refused, f"refused: {who} may not {domain}")
        return False


class Gateway:
    """Sockets of the service; one thread calls everything but the access list."""

    def __init__(self, network: NetworkConfig, run_dir: Path, folder: Path) -> None:
        """Read the keys and listen.

        Raises:
            ConfigError: no key, or the address cannot be used.
        """
        self.address = Address(network.host, network.port)
        self._run_dir, self._folder = run_dir, folder
        self._pair = load_pair(folder / SERVER_KEY_NAME, "the rig's key", _MAKE)
        self.guard = AccessList()
        self._seen: tuple[int, int] | None = None
        self._context: zmq.Context[Any] = zmq.Context()
        self._authenticator = ThreadAuthenticator(self._context)
        self._relay: Relay | None = None
        try:
            self._authenticator.start()
            for domain in ("watch", "steer"):
                self._authenticator.configure_curve_callback(domain, self.guard)
            self._read_allowed()
            self._relay = self._open()
        except BaseException:
            self.close()
            raise

    @property
    def public_key(self) -> str:
        """The rig's public key, for the client's ``--server-key``."""
        return self._pair.public

    def close(self) -> None:
        """Close every socket and end the authenticator's thread."""
        if self._relay is not None:
            self._relay.close()
        self._authenticator.stop()
        self._context.destroy(linger=0)

    def run(self, stop: threading.Event) -> None:
        """Forward messages until stopped; a revoked key is disconnected within a second."""
        notifier = Notifier()
        notifier.ready(f"offered at {self.address}")
        look_s = time.monotonic()
        while not stop.is_set():
            assert self._relay is not None
            self._relay.turn(POLL_MS)
            notifier.alive()
            if time.monotonic() >= look_s + LOOK_S:
                look_s = time.monotonic()
                self._look()
        notifier.stopping()

    # ---- access ----

    def _look(self) -> None:
        before = self.guard.by_key
        if not self._read_allowed():
            return
        after = self.guard.by_key
        if any(key not in after or entry.may != after[key][1].may for key, (_, entry) in before.items()):
            # ZAP asks at the handshake only: close the sockets so that every client must connect again
            if self._relay is not None:
                self._relay.close()
            self._relay = self._open()

    def _read_allowed(self) -> bool:
        """Read the list if it has changed; True if it has. If it cannot be read, no key is allowed."""
        try:
            found = (self._folder / ALLOWED_NAME).stat()
            seen = (found.st_mtime_ns, found.st_ino)
        except OSError:
            seen = (0, 0)
        if seen == self._seen:
            return False
        self._seen = seen
        try:
            entries = load_allowed(self._folder)
        except ConfigError as error:
            logger.error("%s", error)
            entries = {}
        self.guard.by_key = {entry.key: (name, entry) for name, entry in entries.items()}
        logger.info("let in: %s", ", ".join(f"{name} ({entry.may})" for name, entry in entries.items()) or "nobody")
        return True

    def _judge(self, command: Command, who: str) -> Command:
        _, entry = self.guard.by_key.get(who, ("", None))
        if entry is None or entry.may != "steer":
            raise CommandRefusedError("this key may not steer the rig")
        if command.name in LOCAL_ONLY:
            raise CommandRefusedError(f"{command.name} is not taken from another machine")
        # a command without a time stamp would never expire: give it the oldest one
        stamp = command.sent_mono_ns or 1
        client = command.client
        if client and not client.endswith(signature_of(who)):
            client = client[:MAX_CLIENT] + signature_of(who)
        return msgspec.structs.replace(command, sent_mono_ns=stamp, client=client)

    # ---- sockets ----

    def _open(self) -> Relay:
        spoken = {lane: Ends(self._front(zmq.XPUB, lane), self._back(zmq.XSUB, lane)) for lane in SPOKEN}
        return Relay(spoken, Ends(self._front(zmq.ROUTER, ASKED), self._back(zmq.DEALER, ASKED)), self._judge)

    def _front(self, kind: int, lane: str) -> zmq.Socket[Any]:
        socket = open_socket(self._context, kind, lane)
        secure_server(socket, self._pair, "steer" if lane == ASKED else "watch")
        socket.setsockopt(zmq.MAXMSGSIZE, MAX_COMMAND_BYTES)
        socket.setsockopt(zmq.IPV6, int(":" in self.address.host))
        if kind == zmq.XPUB:
            socket.setsockopt(zmq.XPUB_VERBOSE, 1)
        deadline_s = time.monotonic() + REBIND_S
        while True:
            try:
                socket.bind(self.address.endpoint(lane))
                return socket
            except zmq.ZMQError as error:
                if error.errno != zmq.EADDRINUSE or time.monotonic() > deadline_s:
                    socket.close(0)
                    where = self.address.endpoint(lane)
                    raise ConfigError(
                        f"cannot listen on {where}: {error.strerror}; see network.host and .port"
                    ) from None
            time.sleep(0.02)

    def _back(self, kind: int, lane: str) -> zmq.Socket[Any]:
        return connect(self._context, kind, self._run_dir, lane, immediate=kind == zmq.DEALER)


def secure_server(socket: zmq.Socket[Any], pair: KeyPair, domain: str) -> None:
    """Require CURVE with an allowed key; disconnect a peer that is silent."""
    socket.setsockopt(zmq.CURVE_SERVER, 1)
    socket.setsockopt(zmq.CURVE_SECRETKEY, pair.secret.encode())
    socket.setsockopt(zmq.CURVE_PUBLICKEY, pair.public.encode())
    socket.setsockopt(zmq.ZAP_DOMAIN, domain.encode())
    socket.setsockopt(zmq.HANDSHAKE_IVL, SILENCE_MS)
    keep_alive(socket)


def keep_alive(socket: zmq.Socket[Any]) -> None:
    """Detect a dead connection within seconds; otherwise messages sent into it would arrive minutes later."""
    socket.setsockopt(zmq.HEARTBEAT_IVL, HEARTBEAT_MS)
    socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, SILENCE_MS)


def run_gateway(config: LoadedConfig, run_dir: Path) -> None:
    """Run until SIGTERM or SIGINT.

    Raises:
        ConfigError: network.host is empty, there is no key, or the address cannot be used.
        AlreadyRunningError: another gateway holds the lock.
    """
    network = config.rig.network
    if not network.host:
        raise ConfigError("network.host is empty: nothing is offered to other machines; set it in rig.toml")
    lock = lock_service(prepare_run_dir(run_dir), "gateway")
    stop = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: stop.set())
    try:
        gateway = Gateway(network, run_dir, rig_folder(config))
        logger.info("%s offered at %s", ", ".join(OFFERED), gateway.address)
        try:
            gateway.run(stop)
        finally:
            gateway.close()
    finally:
        lock.release()
