"""Subcommands for the way in over TCP: keys, the gateway, and the options that lead a command to a far rig."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from tui.commands.context import Session, json_option, print_json

if TYPE_CHECKING:
    from acquire.remote.keys import May

F = TypeVar("F", bound=Callable[..., Any])


@click.group()
def keys() -> None:
    """Say who may reach the rig over TCP.

    Each side has a pair of keys; the public ones are exchanged by people. At the rig: 'keys make --server' and, for
    each person, 'keys allow NAME KEY'. At the person's machine: 'keys make'."""


@keys.command()
@click.option("--server", is_flag=True, help="The rig's pair instead of your own.")
@click.option("--force", is_flag=True, help="Replace a pair that is there: whoever knows the old one is locked out.")
@click.pass_obj
def make(session: Session, server: bool, force: bool) -> None:
    """Make a pair of keys and print the public one.

    The secret one stays in a file that only its owner can read."""
    from acquire.remote.keys import OWN_KEY_NAME, SERVER_KEY_NAME, make_pair, own_folder, rig_folder

    path = rig_folder(session.config()) / SERVER_KEY_NAME if server else own_folder() / OWN_KEY_NAME
    pair = make_pair(path, force=force)
    click.echo(f"{path} is made; its public key, for {'--server-key' if server else 'keys allow at the rig'}:")
    click.echo(pair.public)
    if server:
        click.echo("a gateway that runs takes it when it is restarted: sudo systemctl restart sweepscope-gateway")


@keys.command("list")
@json_option
@click.pass_obj
def list_(session: Session, as_json: bool) -> None:
    """Show the public keys: your own, the rig's, and who is let in."""
    from acquire.remote.keys import OWN_KEY_NAME, SERVER_KEY_NAME, load_allowed, own_folder, rig_folder

    folder = rig_folder(session.config())
    found = {
        "own": _public(own_folder() / OWN_KEY_NAME),
        "rig": _public(folder / SERVER_KEY_NAME),
        "allowed": load_allowed(folder),
    }
    if as_json:
        print_json(found)
        return
    click.echo(f"your own key    {found['own']}")
    click.echo(f"this rig's key  {found['rig']}")
    for name, entry in load_allowed(folder).items():
        click.echo(f"may {entry.may:<11} {entry.key}  {name}")


def _public(path: Path) -> str:
    from acquire.contract.errors import ConfigError
    from acquire.remote.keys import load_pair

    try:
        return load_pair(path, "the key", "make it").public if path.exists() else "none; 'sweepscope keys make'"
    except ConfigError:
        return f"in {path}, which only its owner can read"


@keys.command()
@click.argument("name")
@click.argument("key")
@click.option("--watch-only", is_flag=True, help="Let it see the rig, and not steer it.")
@click.pass_obj
def allow(session: Session, name: str, key: str, watch_only: bool) -> None:
    """Let the public KEY in, under the NAME of whose it is."""
    from acquire.remote.keys import allow, rig_folder

    may: May = "watch" if watch_only else "steer"
    folder = rig_folder(session.config())
    allow(folder, name, key, may)
    click.echo(f"{name} may {may} the rig")


@keys.command()
@click.argument("name")
@click.pass_obj
def revoke(session: Session, name: str) -> None:
    """Let NAME in no longer; an open connection is cut within a second."""
    from acquire.remote.keys import revoke, rig_folder

    revoke(rig_folder(session.config()), name)
    click.echo(f"{name} is let in no longer")


@click.command()
@click.option("--configured", is_flag=True, hidden=True, help="Exit 0 if network.host names an address, else 1.")
@click.pass_obj
def gateway(session: Session, configured: bool) -> int:
    """Offer the rig to other machines, for those whose key is allowed.

    The address stands in rig.toml (network.host, network.port); see 'sweepscope keys'."""
    if configured:
        return 0 if session.config().rig.network.host else 1
    from tui.processes.parent_watch import follow_parent

    follow_parent()
    session.log_as("gateway")
    from acquire.remote.gateway import run_gateway

    run_gateway(session.config(), session.service_run_dir())
    return 0


def _keep(name: str) -> Callable[[click.Context, click.Parameter, Any], Any]:
    def keep(context: click.Context, _parameter: click.Parameter, value: Any) -> Any:
        if value is not None:
            far = dataclasses.replace(context.obj.far, **{name: value})
            context.obj = dataclasses.replace(context.obj, far=far)
        return value

    return keep


def far_options(function: F) -> F:
    """Add ``--connect``, ``--server-key`` and ``--key``: the command goes to a rig on another machine."""
    for option in (
        click.option(
            "--key",
            type=click.Path(path_type=Path),
            expose_value=False,
            callback=_keep("key"),
            envvar="SWEEPSCOPE_KEY",
            help="File of your own key; else the one that 'keys make' made.",
        ),
        click.option(
            "--server-key",
            metavar="KEY",
            expose_value=False,
            callback=_keep("server_key"),
            envvar="SWEEPSCOPE_SERVER_KEY",
            help="Public key of that rig.",
        ),
        click.option(
            "--connect",
            metavar="tcp://HOST:PORT",
            expose_value=False,
            callback=_keep("address"),
            envvar="SWEEPSCOPE_CONNECT",
            help="A rig on another machine; see 'sweepscope keys'.",
        ),
    ):
        function = option(function)
    return function


COMMANDS: tuple[click.Command, ...] = (keys, gateway)
