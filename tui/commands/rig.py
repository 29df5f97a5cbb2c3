"""Subcommands that ask the running daemon for something: status, scan, estimate, pause, resume, stop."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from tui.commands.context import F, Session, json_option, print_json
from tui.commands.remote import far_options


@click.command()
@json_option
@far_options
@click.pass_obj
def status(session: Session, as_json: bool) -> None:
    """Say what the rig is doing."""
    from tui.text.status_text import status_lines

    with session.client() as client:
        now = client.status()
    if as_json:
        import msgspec

        print_json(msgspec.to_builtins(now))
        return
    for line in status_lines(now):
        click.echo(line)


_PLAN = (
    click.option("--name", default="sweep", show_default=True, help="Part of the scan folder's name."),
    click.option("--first-steps", type=int, help="Position of frame 0 in microsteps."),
    click.option("--last-steps", type=int, help="Position of the last frame in microsteps."),
    click.option("--steps-per-frame", type=click.IntRange(min=1), help="Microsteps between two frames."),
    click.option("--mode", type=click.Choice(["step", "fly"]), help="Stop for each frame, or trigger on the fly."),
    click.option("--settle-ms", type=float, help="Rest between a step and its trigger, in ms."),
    click.option("--specimen", help="What lies on the stage."),
    click.option("--operator", help="Who takes the scan."),
    click.option("--notes", help="Free text that goes into the file."),
    click.option("--tag", "tags", multiple=True, help="May be given more than once."),
    click.option("--purpose", type=click.Choice(["object", "calibration", "raw"]), help="What the scan is for."),
)


def _plan_options(function: F) -> F:
    """The options that say what a scan is."""
    for option in reversed(_PLAN):
        function = option(function)
    return function


@click.command()
@_plan_options
@click.option("--from-proposal", is_flag=True, help="Take bounds and exposure from the last pre-scan.")
@click.option("--wait", is_flag=True, help="Follow the sweep to its end; exit status 4 if frames are missing.")
@json_option
@far_options
@click.pass_obj
def scan(
    session: Session, /, wait: bool, from_proposal: bool, as_json: bool, tags: tuple[str, ...], **args: Any
) -> int:
    """Run a sweep.

    Without --wait the command returns as soon as the sweep has begun."""
    if from_proposal:
        args = _proposed(session) | {name: value for name, value in args.items() if value is not None}
    return _run(session, "scan", wait, as_json, tags=list(tags) or None, **args)


@click.command()
@click.argument("scan", required=False, type=click.Path(path_type=Path))
@click.option("--wait", is_flag=True, help="Follow the sweep to its end; exit status 4 if frames are missing.")
@json_option
@far_options
@click.pass_obj
def resume(session: Session, scan: Path | None, wait: bool, as_json: bool) -> int:
    """Go on with a sweep that holds, or with the interrupted sweep SCAN from its last commit.

    An interrupted sweep goes on only if its last frame, taken again, shows what it showed."""
    if scan is None:
        _ask(session, "resume", as_json)
        return 0
    return _run(session, "resume_scan", wait, as_json, path=str(scan if session.far.address else scan.resolve()))


def _run(session: Session, command: str, wait: bool, as_json: bool, /, **args: Any) -> int:
    """Start a sweep by ``command`` and follow it where that is asked for; returns the exit status."""
    from tui.client.follow import Narrator, exit_status_of, follow_scan
    from tui.text.status_text import outcome_line

    with session.client() as client:
        result = client.request(command, **args).result
        if not wait:
            _show_started(result, as_json)
            return 0
        if not as_json:
            _show_started(result, as_json=False)
        narrator = Narrator(lambda line: click.echo(line, err=as_json))
        end = follow_scan(client, str(result.get("scan_uid", "")), narrator.hear)
    if as_json:
        print_json({**result, "outcome": end.outcome, "committed": end.committed, "missing": end.missing})
    else:
        click.echo(f"{outcome_line(end)}\n{end.scan_path}")
    return exit_status_of(end)


def _proposed(session: Session) -> dict[str, Any]:
    """The bounds of the last pre-scan; its exposure is set."""
    from acquire.contract.errors import CommandRefusedError

    with session.client() as client:
        found = client.request("status").result.get("proposal")
        if found is None:
            raise CommandRefusedError("there is no proposal: run 'sweepscope prescan --wait' first")
        client.request("camera", exposure_ms=found["exposure_ms"])
    return {"first_steps": found["first_steps"], "last_steps": found["last_steps"]}


@click.command()
@_plan_options
@json_option
@click.pass_obj
def estimate(session: Session, /, as_json: bool, tags: tuple[str, ...], **args: Any) -> None:
    """Say how many frames, how long and how much disk a sweep takes.

    Nothing is made and nothing moves; what 'scan' would refuse is refused here in the same words."""
    from acquire.contract.units import format_bytes, format_duration

    with session.client() as client:
        found = client.request("estimate", **args, tags=list(tags) or None).result
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


def _ask(session: Session, name: str, as_json: bool = False, /, **args: Any) -> None:
    with session.client() as client:
        result = client.request(name, **args).result
    if as_json:
        print_json({"ok": True, **result})
    else:
        click.echo(f"{name}: done" if not result else f"{name}: {_in_words(result)}")


def _in_words(result: dict[str, Any]) -> str:
    return ", ".join(f"{key} {value}" for key, value in result.items())


def _simple(name: str, manual: str) -> click.Command:
    @click.command(name, help=manual)
    @json_option
    @far_options
    @click.pass_obj
    def command(session: Session, as_json: bool) -> None:
        _ask(session, name, as_json)

    return command


COMMANDS: tuple[click.Command, ...] = (
    status,
    scan,
    _simple("pause", "Hold the running sweep; nothing is lost."),
    resume,
    _simple("stop", "End the sweep, keep what was taken; stop the stage."),
    estimate,
)
