"""Shared by the subcommands: the session of one invocation, common options, and output as text or as JSON."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from acquire.contract.config.load import LoadedConfig
    from tui.client.rig_client import RigClient


PATH = click.Path(path_type=Path)


class _Text(click.ParamType):
    """Text that goes into files and messages, which are UTF-8."""

    name = "text"

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> str:
        """``value``, unless it holds a byte that is not UTF-8."""
        try:
            value.encode()
        except UnicodeEncodeError:
            self.fail(f"'{value}' holds a byte that is not UTF-8: type it anew", param, ctx)
        return value


TEXT = _Text()


class Number(click.FloatRange):
    """A finite number within bounds; click's own range lets NaN pass."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """``value`` as a number."""
        try:
            float(value)
        except ValueError:
            self.fail(f"{value!r} is no number", param, ctx)
        found = float(super().convert(value, param, ctx))
        if not math.isfinite(found):
            self.fail(f"{value} is no finite number", param, ctx)
        return found


class Position(click.ParamType):
    """Microsteps, or um and mm by ``stage.um_per_microstep`` of this machine; as far as any stage can be."""

    name = "position"
    FARTHEST_STEPS = 10_000_000

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Microsteps."""
        from tui.text.positions import parse_position

        text, um_per_microstep = str(value), 1.0
        if text.strip().endswith("m"):
            session = ctx.find_object(Session) if ctx is not None else None
            if session is None or session.remote.address:
                self.fail(f"{text!r}: give microsteps to a rig on another machine", param, ctx)
            um_per_microstep = session.config().rig.stage.um_per_microstep
        try:
            steps = parse_position(text, um_per_microstep)
        except ValueError as error:
            self.fail(str(error), param, ctx)
        if abs(steps) > self.FARTHEST_STEPS:
            self.fail(f"{text} is farther than any stage goes ({self.FARTHEST_STEPS} microsteps)", param, ctx)
        return steps


POSITION_STEPS = Position()


@dataclass(frozen=True)
class RemoteRig:
    """A rig on another machine, from ``--connect``, ``--server-key`` and ``--key``."""

    address: str = ""
    """tcp://host:port; empty: the rig on this machine."""
    server_key: str = ""
    """Its public key in Z85."""
    key: Path | None = None
    """File of our own key pair; None: the default one."""


@dataclass(frozen=True)
class Session:
    """One invocation of the command line."""

    config_path: str | None
    """``--config``; None: look in the default places."""
    debug: bool = False
    """``--debug``."""
    remote: RemoteRig = RemoteRig()

    def config(self) -> LoadedConfig:
        """The effective configuration (raises ConfigError)."""
        from acquire.contract.config.load import load_config

        return load_config(self.config_path)

    @contextmanager
    def client(self) -> Iterator[RigClient]:
        """A client of the running daemon, on this machine or a remote one (raises NoServiceError)."""
        from acquire.contract.process.run_dir import client_run_dir
        from tui.client.client_name import my_name_at_a_terminal
        from tui.client.rig_client import RigClient

        timeout_s = self.config().rig.limits.command_s
        with self.tunnel() as remote_dir:
            where = remote_dir or client_run_dir()
            with RigClient(where, timeout_s=timeout_s, client=my_name_at_a_terminal()) as client:
                yield client

    def request(self, name: str, /, **args: Any) -> dict[str, Any]:
        """The daemon's reply to one command (raises CommandRefusedError, NoServiceError)."""
        with self.client() as client:
            return client.request(name, **args).result

    @contextmanager
    def tunnel(self) -> Iterator[Path | None]:
        """Connect to the remote rig while inside; yields the folder of its sockets, None if no rig was named.

        Raises:
            NoServiceError: it does not answer or refuses our key; the message says why.
            ConfigError: no address, no key, or no key pair of our own.
        """
        if not self.remote.address:
            yield None
            return
        from acquire.contract.errors import ConfigError
        from acquire.remote.addresses import parse_address
        from acquire.remote.keys import OWN_KEY_NAME, check_public, load_pair, own_folder
        from acquire.remote.tunnel import Tunnel

        address = parse_address(self.remote.address)
        if not self.remote.server_key:
            raise ConfigError("--connect needs --server-key: 'sweepscope keys list' at the rig shows it")
        pair = load_pair(self.remote.key or own_folder() / OWN_KEY_NAME, "your key", "'sweepscope keys make' makes it")
        with Tunnel(address, check_public(self.remote.server_key), pair) as tunnel:
            tunnel.wait(self.config().rig.limits.command_s)
            yield tunnel.run_dir

    def service_run_dir(self) -> Path:
        """The directory of the services' sockets; it is created if missing."""
        from acquire.contract.process.run_dir import prepare_run_dir, service_run_dir

        return prepare_run_dir(service_run_dir())

    def begin_service(self, name: str) -> None:
        """Log as the service ``name``, to the journal or to stderr, and end when the supervisor dies."""
        from acquire.contract.process.logs import set_up
        from tui.processes.parent_watch import follow_parent

        follow_parent()
        set_up(name, debug=self.debug)


def _keep(name: str) -> Callable[[click.Context, click.Parameter, Any], Any]:
    def keep(context: click.Context, _parameter: click.Parameter, value: Any) -> Any:
        if value is not None:
            remote = dataclasses.replace(context.obj.remote, **{name: value})
            context.obj = dataclasses.replace(context.obj, remote=remote)
        return value

    return keep


_REMOTE_OPTIONS = (
    click.option(
        "--connect",
        type=TEXT,
        metavar="tcp://HOST:PORT",
        expose_value=False,
        callback=_keep("address"),
        envvar="SWEEPSCOPE_CONNECT",
        help="A rig on another machine; see 'sweepscope keys'.",
    ),
    click.option(
        "--server-key",
        type=TEXT,
        metavar="KEY",
        expose_value=False,
        callback=_keep("server_key"),
        envvar="SWEEPSCOPE_SERVER_KEY",
        help="Public key of that rig.",
    ),
    click.option(
        "--key",
        type=PATH,
        expose_value=False,
        callback=_keep("key"),
        envvar="SWEEPSCOPE_KEY",
        help="File of your own key [the one of 'keys make'].",
    ),
)


def options(*several: Callable[..., Any]) -> Callable[..., Any]:
    """One decorator of several options; the help shows them in this order."""

    def decorate(function: Any) -> Any:
        for option in reversed(several):
            function = option(function)
        return function

    return decorate


json_option = click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
remote_options = options(*_REMOTE_OPTIONS)
rig_options = options(json_option, remote_options, click.pass_obj)
"""Options of a command for a daemon, on this machine or a remote one; the first argument is the session."""
progress_option = click.option("--progress", "with_progress", is_flag=True, help="Report progress on stderr, as JSON.")
force_option = click.option("--force", is_flag=True, help="Replace an existing file.")


def size_callback(_context: click.Context, _parameter: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Click callback of an option ``WxH``: two numbers; None without a value."""
    from tui.text.sizes import parse_size

    try:
        return None if value is None else parse_size(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


def request(session: Session, name: str, as_json: bool, /, **args: Any) -> None:
    """Send a command to the daemon and print its reply."""
    show_reply(name, session.request(name, **args), as_json)


def show_reply(name: str, result: dict[str, Any], as_json: bool) -> None:
    """Print the daemon's reply to a command."""
    if as_json:
        print_json({"ok": True, **result})
    else:
        from acquire.contract.permissions import accepted_words

        click.echo(f"{name}: " + (", ".join(f"{key} {value}" for key, value in result.items()) or accepted_words(name)))


def progress_printer(with_progress: bool, *, every_s: float = 0.2) -> Callable[[int, int], None]:
    """A callback for (done, total) that prints JSON lines on stderr, at most one per ``every_s``; or nothing."""
    said_s = float("-inf")

    def say(done: int, total: int) -> None:
        nonlocal said_s
        now_s = time.monotonic()
        if with_progress and (now_s - said_s >= every_s or done >= total):
            said_s = now_s
            click.echo(json.dumps({"done": done, "total": total}), err=True)

    return say


def progress_words(what: str, *, after_s: float = 2.0) -> Callable[[int, int], None]:
    """A callback for (done, total) that says on stderr how far ``what`` is, every ``after_s``; not if it is short."""
    said_s = time.monotonic()

    def say(done: int, total: int) -> None:
        nonlocal said_s
        now_s = time.monotonic()
        if now_s - said_s >= after_s and done < total:
            said_s = now_s
            click.echo(f"{what}: {100 * done // max(total, 1)} %", err=True)

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
    if isinstance(value, bytes):
        return value.decode("utf-8", "backslashreplace")
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value if value is None or isinstance(value, (bool, int, float, str)) else str(value)
