"""Subcommands for sweeps: status, scan, estimate, pause, resume, stop. The running daemon does the work."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tui.commands.context import (
    PATH,
    POSITION_STEPS,
    TEXT,
    Number,
    Session,
    json_option,
    options,
    print_json,
    request,
    rig_options,
)


@click.command()
@rig_options
def status(session: Session, as_json: bool) -> None:
    """Show what the rig is doing."""
    from tui.text.status_text import status_lines

    with session.client() as client:
        now = client.status()
    if as_json:
        import msgspec

        print_json(msgspec.to_builtins(now))
        return
    for line in status_lines(now):
        click.echo(line)


_plan_options = options(
    click.option("--name", type=TEXT, default="sweep", show_default=True, help="Part of the scan folder's name."),
    click.option("--first-steps", type=POSITION_STEPS, help="Position of frame 0 in microsteps."),
    click.option("--last-steps", type=POSITION_STEPS, help="Position of the last frame in microsteps."),
    click.option("--steps-per-frame", type=click.IntRange(1, 100_000), help="Microsteps between two frames."),
    click.option("--mode", type=click.Choice(["step", "fly"]), help="Stop for each frame, or trigger on the fly."),
    click.option("--settle-ms", type=Number(0, 60_000), help="Pause between a step and its trigger, in ms."),
    click.option("--specimen", type=TEXT, help="Name of the specimen."),
    click.option("--operator", type=TEXT, help="Name of the operator."),
    click.option("--notes", type=TEXT, help="Free text, stored in the file."),
    click.option("--tag", "tags", type=TEXT, multiple=True, help="May be given more than once."),
    click.option("--purpose", type=click.Choice(["object", "calibration", "raw"]), help="Use of the scan."),
)


@click.command()
@_plan_options
@click.option("--from-proposal", is_flag=True, help="Take bounds and exposure from the last pre-scan.")
@click.option("--wait", is_flag=True, help="Follow the sweep to its end; exit status 4 if frames are missing.")
@rig_options
def scan(
    session: Session, /, wait: bool, from_proposal: bool, as_json: bool, tags: tuple[str, ...], **args: Any
) -> int:
    """Run a sweep.

    Without --wait the command returns as soon as the sweep has begun."""
    if from_proposal:
        args = _proposed(session) | {name: value for name, value in args.items() if value is not None}
    return _run(session, "scan", wait, as_json, tags=list(tags) or None, **args)


@click.command()
@click.argument("scan", required=False, type=PATH)
@click.option("--wait", is_flag=True, help="Follow the sweep to its end; exit status 4 if frames are missing.")
@rig_options
def resume(session: Session, scan: Path | None, wait: bool, as_json: bool) -> int:
    """Resume a held sweep, or the interrupted or stopped sweep SCAN.

    It goes on after its last committed frame, and only if that frame, taken again, shows the same."""
    if scan is None:
        request(session, "resume", as_json)
        return 0
    return _run(session, "resume_scan", wait, as_json, path=str(scan if session.remote.address else scan.resolve()))


def _run(session: Session, command: str, wait: bool, as_json: bool, /, **args: Any) -> int:
    """Start a sweep by ``command``, and follow it with ``wait``; returns the exit status."""
    from tui.client.follow import ProgressPrinter, exit_status_of, follow_scan
    from tui.text.status_text import outcome_line

    with session.client() as client:
        result = client.request(command, **args).result
        if not wait:
            _show_started(result, as_json)
            return 0
        if not as_json:
            _show_started(result, as_json=False)
        printer = ProgressPrinter(lambda line: click.echo(line, err=as_json))
        end = follow_scan(client, str(result.get("scan_uid", "")), printer.take)
    if as_json:
        print_json({**result, "outcome": end.outcome, "committed": end.committed, "missing": end.missing})
    else:
        click.echo(f"{outcome_line(end)}\n{end.scan_path}")
    return exit_status_of(end)


def _proposed(session: Session) -> dict[str, Any]:
    """The bounds of the last pre-scan; sets the camera to its exposure."""
    from acquire.contract.errors import CommandRefusedError

    found = session.request("status").get("proposal")
    if found is None:
        raise CommandRefusedError("there is no proposal: run 'sweepscope prescan --wait' first")
    session.request("camera", exposure_ms=found["exposure_ms"])
    return {"first_steps": found["first_steps"], "last_steps": found["last_steps"]}


@click.command()
@_plan_options
@json_option
@click.pass_obj
def estimate(session: Session, /, as_json: bool, tags: tuple[str, ...], **args: Any) -> None:
    """Estimate the frames, time and disk space of a sweep.

    Nothing is written and nothing moves. A plan that 'scan' would refuse is refused here with the same message."""
    from acquire.contract.units import format_bytes, format_duration

    found = session.request("estimate", **args, tags=list(tags) or None)
    if as_json:
        print_json(found)
        return
    need, free = format_bytes(found["bytes"]), format_bytes(found["free_bytes"])
    click.echo(f"{found['expected']} frames, {format_duration(found['seconds'])}, {need} of {free} free")
    for warning in found["warnings"]:
        click.echo(f"warning: {warning}")


def _show_started(result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(result)
    else:
        click.echo(f"sweep of {result.get('expected', '?')} frames into {result.get('path', '?')}")


def _command_without_arguments(name: str, manual: str) -> click.Command:
    @click.command(name, help=manual)
    @rig_options
    def command(session: Session, as_json: bool) -> None:
        request(session, name, as_json)

    return command


COMMANDS: tuple[click.Command, ...] = (
    status,
    scan,
    _command_without_arguments("pause", "Hold the running sweep; nothing is lost."),
    resume,
    _command_without_arguments("stop", "End the sweep, keep the frames taken so far; stop the stage."),
    estimate,
)
