"""Subcommands for the stage's controller alone; the daemon must not run meanwhile: the port belongs to one program."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

import click

from tui.commands.context import Session


@click.group()
def stage() -> None:
    """Look after the stage's controller."""


@stage.command()
@click.option("--port", help="Serial port; default: stage.port, or the only one there is.")
@click.pass_obj
def check(session: Session, port: str | None) -> int:
    """Check each wire: moves the stage by 100 microsteps, asks, and says what it saw. Home the stage afterwards."""
    import msgspec

    from acquire.stages.check import StageCheck
    from acquire.stages.uno import UnoStage

    config = session.config().rig.stage
    if port is not None:
        config = msgspec.structs.replace(config, port=port)
    findings = StageCheck(UnoStage(config), click.echo, click.confirm).run()
    return int(any(not finding.good for finding in findings))


COMMANDS: tuple[click.Command, ...] = (stage,)
