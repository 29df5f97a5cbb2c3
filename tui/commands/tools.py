"""Subcommands that describe the program: the effective configuration, the version."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

import click

from tui.commands.context import Session, json_option, print_json


@click.command()
@json_option
@click.pass_obj
def config(session: Session, as_json: bool) -> None:
    """Print the effective configuration and its manual.

    Each key stands with its manual, its value, and where the value came from."""
    import msgspec

    loaded = session.config()
    if as_json:
        values = msgspec.to_builtins(loaded.rig)
        path = str(loaded.path) if loaded.path else None
        print_json({"path": path, "values": values, "origins": loaded.origins})
        return
    click.echo(f"# {loaded.path or 'no rig.toml found: defaults'}\n\n{loaded.explained()}", nl=False)


@click.command()
@json_option
def version(as_json: bool) -> None:
    """Print the versions of program, protocol and file layout."""
    from importlib.metadata import version as installed

    from acquire.contract.messaging.messages import PROTOCOL
    from acquire.contract.scan_data.dataset_names import LAYOUT_VERSION

    facts = {"program": installed("sweepscope"), "protocol": list(PROTOCOL), "layout": LAYOUT_VERSION}
    if as_json:
        print_json(facts)
        return
    major, minor = PROTOCOL
    click.echo(f"sweepscope {facts['program']} (protocol {major}.{minor}, scan file layout {LAYOUT_VERSION})")


COMMANDS: tuple[click.Command, ...] = (config, version)
