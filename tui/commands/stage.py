"""Subcommands for the stage's controller. The daemon must not run: only one program can open the serial port."""

from __future__ import annotations

import click

from tui.commands.context import POSITION_STEPS, TEXT, Session, json_option, print_json


@click.group()
def stage() -> None:
    """Check and tune the stage's controller."""


@stage.command()
@click.option("--port", type=TEXT, help="Serial port; default: stage.port, or the only one there is.")
@click.pass_obj
def check(session: Session, port: str | None) -> int:
    """Check each wire: moves the stage by 100 microsteps, asks, and reports. Home the stage afterwards."""
    import msgspec

    from acquire.stages.uno.stage import UnoStage
    from acquire.stages.wiring_check import StageCheck

    config = session.config().rig.stage
    if port is not None:
        config = msgspec.structs.replace(config, port=port)
    findings = StageCheck(UnoStage(config), click.echo, click.confirm).run()
    return int(any(not finding.good for finding in findings))


@stage.command()
@click.option("--position-steps", type=POSITION_STEPS, help="Where to measure; default: the middle of the sweep.")
@json_option
@click.pass_obj
def settle(session: Session, position_steps: int | None, as_json: bool) -> None:
    """Measure how long the picture needs to settle after a step, and propose stage.settle_ms."""
    import msgspec

    from acquire.rig_tools.settle_time import SettleMeasurement
    from acquire.rigs.build import build_rig

    rig = session.config().rig
    if position_steps is None:
        position_steps = (rig.sweep.first_steps + rig.sweep.last_steps) // 2
    report = SettleMeasurement(build_rig(rig), rig, position_steps).run()
    if as_json:
        print_json(msgspec.to_builtins(report))
        return
    for delay_ms, difference in zip(report.delays_ms, report.differences, strict=True):
        click.echo(f"{delay_ms:6.0f} ms  differs by {difference:6.3f} counts (at rest {report.noise:.3f})")
    if report.settle_ms is None:
        click.echo("the picture did not come to rest: is the stage screwed down, is the light steady?")
    else:
        click.echo(f"proposal: settle_ms = {report.settle_ms:g} in [stage]")


COMMANDS: tuple[click.Command, ...] = (stage,)
