"""What every subcommand shares: the session of one invocation, and printing of results as words or as JSON."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from acquire.contract.config.load import LoadedConfig
    from tui.client.rig_client import RigClient

F = TypeVar("F", bound=Callable[..., Any])


@dataclass(frozen=True)
class FarRig:
    """A rig on another machine, as ``--connect`` and its companions name it; empty: the one on this machine."""

    address: str = ""
    """tcp://host:port."""
    server_key: str = ""
    """Its public key in Z85."""
    key: Path | None = None
    """File of our own pair; None: the usual one."""


@dataclass(frozen=True)
class Session:
    """One invocation of the command line."""

    config_path: str | None
    """``--config``; None: look in the usual places."""
    debug: bool = False
    """``--debug``."""
    far: FarRig = FarRig()

    def config(self) -> LoadedConfig:
        """The effective configuration (raises ConfigError)."""
        from acquire.contract.config.load import load_config

        return load_config(self.config_path)

    @contextmanager
    def client(self) -> Iterator[RigClient]:
        """A client of the running daemon, here or far away (raises NoServiceError)."""
        from acquire.contract.process.run_dir import client_run_dir
        from tui.client.client_name import my_name_at_a_terminal
        from tui.client.rig_client import RigClient

        timeout_s = self.config().rig.limits.command_s
        with self.tunnel() as far_dir:
            where = far_dir or client_run_dir()
            with RigClient(where, timeout_s=timeout_s, client=my_name_at_a_terminal()) as client:
                yield client

    @contextmanager
    def tunnel(self) -> Iterator[Path | None]:
        """While inside, the folder with the lanes of a far rig; None if none was named.

        Raises:
            NoServiceError: it does not answer or does not let us in; why is said.
            ConfigError: no address, no key, or no pair of our own.
        """
        if not self.far.address:
            yield None
            return
        from acquire.contract.errors import ConfigError
        from acquire.remote.addresses import parse_address
        from acquire.remote.keys import OWN_KEY_NAME, check_public, load_pair, own_folder
        from acquire.remote.tunnel import Tunnel

        address = parse_address(self.far.address)
        if not self.far.server_key:
            raise ConfigError("--connect needs --server-key: 'sweepscope keys list' at the rig shows it")
        pair = load_pair(self.far.key or own_folder() / OWN_KEY_NAME, "your key", "'sweepscope keys make' makes it")
        with Tunnel(address, check_public(self.far.server_key), pair) as tunnel:
            tunnel.wait(self.config().rig.limits.command_s)
            yield tunnel.run_dir

    def service_run_dir(self) -> Path:
        """The directory of the services' sockets, made if it is not there."""
        from acquire.contract.process.run_dir import prepare_run_dir, service_run_dir

        return prepare_run_dir(service_run_dir())

    def log_as(self, service: str) -> None:
        """Send log records to the journal, or to stderr, one line each, with the service's name."""
        from acquire.contract.process.logs import set_up

        set_up(service, debug=self.debug)


def json_option(function: F) -> F:
    """Add ``--json`` to a command."""
    return click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")(function)


def progress_option(function: F) -> F:
    """Add ``--progress`` to a command that takes long."""
    return click.option("--progress", "with_progress", is_flag=True, help="Say on stderr how far it is, as JSON.")(
        function
    )


def progress_printer(with_progress: bool, *, every_s: float = 0.2) -> Callable[[int, int], None]:
    """Called with (done, total); prints one JSON object on a line of stderr now and then, or nothing."""
    said_s = float("-inf")

    def say(done: int, total: int) -> None:
        nonlocal said_s
        now_s = time.monotonic()
        if with_progress and (now_s - said_s >= every_s or done >= total):
            said_s = now_s
            click.echo(json.dumps({"done": done, "total": total}), err=True)

    return say


def print_json(value: Any) -> None:
    """One JSON object on stdout; structs and dataclasses become objects, NaN becomes null."""
    click.echo(json.dumps(plain(value)))


def plain(value: Any) -> Any:
    """``value`` as plain dicts, lists and scalars; NaN and infinities become None (JSON has none)."""
    import msgspec

    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
    elif isinstance(value, msgspec.Struct):
        value = msgspec.structs.asdict(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
