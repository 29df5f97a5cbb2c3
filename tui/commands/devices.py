"""Subcommands for stage, lamp and camera, pre-scan, simulated specimen, and control of the rig."""

from __future__ import annotations

from typing import Any

import click

from tui.commands.context import (
    POSITION_STEPS,
    TEXT,
    Number,
    Session,
    json_option,
    print_json,
    request,
    rig_options,
    show_reply,
)

_wait = click.option("--wait", is_flag=True, help="Return when it has ended; exit status 1 if it failed.")
_SETTINGS = ("exposure_ms", "gain", "brightness_percent")


def _move(session: Session, name: str, wait: bool, as_json: bool, /, **args: int) -> None:
    """Request a move; with ``wait`` check that it ends at its target."""
    from acquire.contract.errors import SweepscopeError
    from tui.client.wait import until_rest

    with session.client() as client:
        result = client.request(name, **args).result
        if wait:
            end = until_rest(client)
            target = result.get("target_steps", end["position_steps"])
            if end["position_steps"] != target or end["state"] == "fault" or not end["position_trusted"]:
                raise SweepscopeError(f"{name}: the stage stopped at {end['position_steps']}; {end['message']}")
            result |= {"position_steps": end["position_steps"]}
    show_reply(name, result, as_json)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("position_steps", metavar="POSITION", type=POSITION_STEPS)
@_wait
@rig_options
def goto(session: Session, position_steps: int, wait: bool, as_json: bool) -> None:
    """Move the stage to POSITION: microsteps (1578), um (5010um) or mm (5.01mm)."""
    _move(session, "goto", wait, as_json, position_steps=position_steps)


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("steps", type=POSITION_STEPS)
@_wait
@rig_options
def jog(session: Session, steps: int, wait: bool, as_json: bool) -> None:
    """Move the stage by STEPS: microsteps (-20), um (63.5um) or mm; negative is back."""
    _move(session, "jog", wait, as_json, steps=steps)


@click.command()
@_wait
@rig_options
def home(session: Session, wait: bool, as_json: bool) -> None:
    """Find the zero of the stage."""
    _move(session, "home", wait, as_json)


@click.command()
@rig_options
def zero(session: Session, as_json: bool) -> None:
    """Make the present position the zero of the stage."""
    request(session, "zero", as_json)


@click.command()
@click.argument("switch", type=click.Choice(["on", "off"]))
@rig_options
def lamp(session: Session, switch: str, as_json: bool) -> None:
    """Switch the lamp on or off."""
    request(session, "lamp", as_json, on=switch == "on")


@click.group()
def camera() -> None:
    """Show and change the camera's settings."""


@camera.command("show")
@rig_options
def camera_show(session: Session, as_json: bool) -> None:
    """Print each setting with its limits."""
    status = session.request("status")
    settings, limits = status["camera"], status["camera_limits"]
    if as_json:
        print_json({"camera": settings, "limits": limits})
        return
    for name, value in settings.items():
        low, high = limits.get(name, ("?", "?"))
        click.echo(f"{name.replace('_', '-')} {value:g}  ({low}..{high})")


def _settings(_context: click.Context, _parameter: click.Parameter, values: tuple[str, ...]) -> dict[str, float]:
    found = {}
    for text in values:
        name, _, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if name not in _SETTINGS:
            known = ", ".join(setting.replace("_", "-") for setting in _SETTINGS)
            raise click.BadParameter(f"{text!r} is not NAME=NUMBER with one of {known}")
        found[name] = Number().convert(value, _parameter, _context)
    return found


@camera.command("set")
@click.argument("settings", metavar="NAME=NUMBER...", nargs=-1, required=True, callback=_settings)
@rig_options
def camera_set(session: Session, settings: dict[str, float], as_json: bool) -> None:
    """Change settings, such as gain=12 exposure-ms=20; the others stay."""
    request(session, "camera", as_json, **settings)


def _run(session: Session, name: str, wait: bool, /, **args: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Start an activity; with ``wait`` check that it succeeds. Returns the reply and the last status."""
    from acquire.contract.errors import SweepscopeError
    from tui.client.wait import until_rest

    failed = "activities_failed"
    with session.client() as client:
        before = client.request("status").result["counters"].get(failed, 0)
        result = client.request(name, **args).result
        if not wait:
            return result, {}
        end = until_rest(client)
    if end["counters"].get(failed, 0) != before:
        raise SweepscopeError(end["message"])
    return result, end


@camera.command("expose")
@_wait
@rig_options
def camera_expose(session: Session, wait: bool, as_json: bool) -> None:
    """Find the exposure once, with the light on the specimen, and keep it."""
    result, end = _run(session, "expose", wait)
    if end:
        result = {"exposure_ms": end["camera"]["exposure_ms"], "message": end["message"]}
    show_reply("expose", result, as_json)


@click.command()
@click.option("--first-steps", type=POSITION_STEPS, help="First position, in microsteps.")
@click.option("--last-steps", type=POSITION_STEPS, help="Last position, in microsteps.")
@click.option(
    "--every-steps", type=click.IntRange(1, 100_000), help="Microsteps between two positions; 20 frames if not given."
)
@_wait
@rig_options
def prescan(session: Session, /, wait: bool, as_json: bool, **args: Any) -> None:
    """Propose bounds and exposure from a coarse sweep.

    Pictures are taken at every n-th position. 'sweepscope scan --from-proposal' uses the proposal; 'sweepscope stop'
    ends it early."""
    result, end = _run(session, "prescan", wait, **args)
    if not end:
        show_reply("prescan", result, as_json)
        return
    proposal = end["proposal"]
    if as_json:
        print_json(proposal)
        return
    click.echo(end["message"])
    for warning in proposal["warnings"]:
        click.echo(f"warning: {warning}")


@click.command()
@click.argument("action", type=click.Choice(["take", "release"]))
@rig_options
def control(session: Session, action: str, as_json: bool) -> None:
    """Take control of the rig for this terminal, or give it back.

    It expires ten seconds after the holder's last command; a console keeps it while it runs."""
    request(session, "control", as_json, action=action)


@camera.command("capture")
@click.argument("path", type=TEXT, required=False)
@_wait
@json_option
@click.pass_obj
def camera_capture(session: Session, path: str | None, wait: bool, as_json: bool) -> None:
    """Take one picture in full size as PATH, a .png within the folder of scans [captures/<time>.png there]."""
    result, _ = _run(session, "capture", wait, path=path)
    show_reply("capture", result, as_json)


@click.command()
@click.option("--object", "object_", type=click.Choice(["stirrup", "dome", "wedge", "flat", "checkerboard"]))
@click.option("--tilt-x", "tilt_x_deg", type=Number(-30, 30), help="Degrees; positive lifts the far side.")
@click.option("--tilt-y", "tilt_y_deg", type=Number(-30, 30), help="Degrees; positive lifts the left side.")
@click.option("--yaw", "yaw_deg", type=Number(-180, 180), help="Turn about the vertical in degrees.")
@_wait
@json_option
@click.pass_obj
def specimen(session: Session, /, object_: str | None, wait: bool, as_json: bool, **args: Any) -> None:
    """Change or tilt the specimen of the simulated rig.

    Options that are left out keep their value."""
    result, _ = _run(session, "specimen", wait, object=object_, **args)
    show_reply("specimen", result, as_json)


COMMANDS: tuple[click.Command, ...] = (goto, jog, home, zero, lamp, camera, prescan, specimen, control)
