"""Subcommands for remote access over TCP: keys and gateway."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from tui.commands.context import TEXT, Session, json_option, print_json

if TYPE_CHECKING:
    from acquire.remote.keys import May


@click.group()
def keys() -> None:
    """Manage the keys of remote access over TCP.

    Each side has a key pair; the users exchange the public keys. At the rig: 'keys make --server' and, for
    each person, 'keys allow NAME KEY'. At the person's machine: 'keys make'."""


@keys.command()
@click.option("--server", is_flag=True, help="The key pair of the rig instead of your own.")
@click.option(
    "--force", is_flag=True, help="Replace an existing pair: users with the old public key can no longer connect."
)
@click.pass_obj
def make(session: Session, server: bool, force: bool) -> None:
    """Create a key pair and print the public key.

    The secret key stays in a file that only its owner can read."""
    from acquire.remote.keys import OWN_KEY_NAME, SERVER_KEY_NAME, make_pair, own_folder, rig_folder

    path = rig_folder(session.config()) / SERVER_KEY_NAME if server else own_folder() / OWN_KEY_NAME
    pair = make_pair(path, force=force)
    click.echo(f"{path} is made; its public key, for {'--server-key' if server else 'keys allow at the rig'}:")
    click.echo(pair.public)
    if server:
        click.echo("restart a running gateway to use it: sudo systemctl restart sweepscope-gateway")


@keys.command("list")
@json_option
@click.pass_obj
def list_(session: Session, as_json: bool) -> None:
    """Show the public keys: your own, the rig's, and the allowed ones."""
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
@click.argument("name", type=TEXT)
@click.argument("key", type=TEXT)
@click.option("--watch-only", is_flag=True, help="Allow it to watch the rig, not to control it.")
@click.pass_obj
def allow(session: Session, name: str, key: str, watch_only: bool) -> None:
    """Allow connections with the public KEY of NAME."""
    from acquire.remote.keys import allow, rig_folder

    may: May = "watch" if watch_only else "steer"
    folder = rig_folder(session.config())
    allow(folder, name, key, may)
    click.echo(f"{name} may {may} the rig")


@keys.command()
@click.argument("name", type=TEXT)
@click.pass_obj
def revoke(session: Session, name: str) -> None:
    """Refuse the key of NAME from now on; an open connection is closed within a second."""
    from acquire.remote.keys import revoke, rig_folder

    revoke(rig_folder(session.config()), name)
    click.echo(f"the key of {name} is no longer allowed")


@click.command()
@click.option("--configured", is_flag=True, hidden=True, help="Exit 0 if network.host names an address, else 1.")
@click.pass_obj
def gateway(session: Session, configured: bool) -> int:
    """Give other machines access to the rig, with an allowed key.

    The address is set in rig.toml (network.host, network.port); see 'sweepscope keys'."""
    if configured:
        return 0 if session.config().rig.network.host else 1
    session.begin_service("gateway")
    from acquire.remote.gateway import run_gateway

    run_gateway(session.config(), session.service_run_dir())
    return 0


COMMANDS: tuple[click.Command, ...] = (keys, gateway)
