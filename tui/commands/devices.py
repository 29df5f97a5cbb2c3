"""Subcommands for stage, lamp and camera, the pre-scan, and who holds control."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from tui.commands.context import Session, json_option, print_json
from tui.commands.remote import far_options

if TYPE_CHECKING:
    from tui.client.rig_client import RigClient

_wait = click.option("--wait", is_flag=True, help="Return when it is done; exit status 1 if it was not.")
_SETTINGS = ("exposure_ms", "gain", "brightness_percent")


def _move(session: Session, name: str, *, wait: bool, as_json: bool, args: dict[str, Any]) -> None:
    """Ask for a move; with ``wait`` see it end where it must."""
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
    _show(name, result, as_json)


def _show(name: str, result: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print_json({"ok": True, **result})
    else:
        click.echo(f"{name}: " + (", ".join(f"{key} {value}" for key, value in result.items()) or "done"))


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("position_steps", type=int)
@_wait
@json_option
@far_options
@click.pass_obj
def goto(session: Session, position_steps: int, wait: bool, as_json: bool) -> None:
    """Move the stage to POSITION_STEPS microsteps."""
    _move(session, "goto", wait=wait, as_json=as_json, args={"position_steps": position_steps})


@click.command(context_settings={"ignore_unknown_options": True})
@click.argument("steps", type=int)
@_wait
@json_option
@far_options
@click.pass_obj
def jog(session: Session, steps: int, wait: bool, as_json: bool) -> None:
    """Move the stage by STEPS microsteps (negative: back)."""
    _move(session, "jog", wait=wait, as_json=as_json, args={"steps": steps})


@click.command()
@_wait
@json_option
@far_options
@click.pass_obj
def home(session: Session, wait: bool, as_json: bool) -> None:
    """Find the zero of the stage."""
    _move(session, "home", wait=wait, as_json=as_json, args={})


@click.command()
@json_option
@far_options
@click.pass_obj
def zero(session: Session, as_json: bool) -> None:
    """Make the present position the zero of the stage."""
    _move(session, "zero", wait=False, as_json=as_json, args={})


@click.command()
@click.argument("switch", type=click.Choice(["on", "off"]))
@json_option
@far_options
@click.pass_obj
def lamp(session: Session, switch: str, as_json: bool) -> None:
    """Switch the lamp on or off."""
    with session.client() as client:
        result = client.request("lamp", on=switch == "on").result
    _show("lamp", result, as_json)


@click.group()
def camera() -> None:
    """Show and change the camera's settings."""


@camera.command("show")
@json_option
@far_options
@click.pass_obj
def camera_show(session: Session, as_json: bool) -> None:
    """Print each setting with its limits."""
    with session.client() as client:
        status = client.request("status").result
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
        try:
            found[name] = float(value)
        except ValueError:
            raise click.BadParameter(f"{text!r}: {value!r} is no number") from None
    return found


@camera.command("set")
@click.argument("settings", metavar="NAME=NUMBER...", nargs=-1, required=True, callback=_settings)
@json_option
@far_options
@click.pass_obj
def camera_set(session: Session, settings: dict[str, float], as_json: bool) -> None:
    """Change settings, such as gain=12 exposure-ms=20; the others stay."""
    with session.client() as client:
        result = client.request("camera", **settings).result
    _show("camera", result, as_json)


def _run(client: RigClient, name: str, args: dict[str, Any], *, wait: bool) -> tuple[dict[str, Any], dict[str, Any]]:
    """Begin an activity; with ``wait`` see it end well. Returns the reply and the last status."""
    from acquire.contract.errors import SweepscopeError
    from tui.client.wait import until_rest

    failed = "activities_failed"
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
@json_option
@far_options
@click.pass_obj
def camera_expose(session: Session, wait: bool, as_json: bool) -> None:
    """Search the exposure once, with the light over the specimen; then it stays."""
    with session.client() as client:
        result, end = _run(client, "expose", {}, wait=wait)
    if end:
        result = {"exposure_ms": end["camera"]["exposure_ms"], "message": end["message"]}
    _show("expose", result, as_json)


@click.command()
@click.option("--first-steps", type=int, help="Where the looks begin, in microsteps.")
@click.option("--last-steps", type=int, help="Where they end, in microsteps.")
@click.option("--every-steps", type=click.IntRange(min=1), help="Microsteps between two looks; 20 frames if not given.")
@_wait
@json_option
@far_options
@click.pass_obj
def prescan(session: Session, /, wait: bool, as_json: bool, **args: Any) -> None:
    """Look at every n-th position of a sweep and propose its bounds and exposure.

    'sweepscope scan --from-proposal' takes them over; 'sweepscope stop' ends it early."""
    with session.client() as client:
        result, end = _run(client, "prescan", args, wait=wait)
    if not end:
        _show("prescan", result, as_json)
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
@json_option
@far_options
@click.pass_obj
def control(session: Session, action: str, as_json: bool) -> None:
    """Take control of the rig for this terminal, or give it back.

    It lapses ten seconds after the holder's last command; a console keeps it as long as it runs."""
    with session.client() as client:
        result = client.request("control", action=action).result
    _show("control", result, as_json)


@camera.command("capture")
@click.argument("path", required=False)
@_wait
@json_option
@click.pass_obj
def camera_capture(session: Session, path: str | None, wait: bool, as_json: bool) -> None:
    """Take one picture in full size as PATH, a .png within the folder of scans [captures/<time>.png there]."""
    with session.client() as client:
        result, _ = _run(client, "capture", {"path": path}, wait=wait)
    _show("capture", result, as_json)


@click.command()
@click.option("--object", "object_", type=click.Choice(["stirrup", "dome", "wedge", "flat", "checkerboard"]))
@click.option("--tilt-x", "tilt_x_deg", type=float, help="Degrees; positive lifts the far side.")
@click.option("--tilt-y", "tilt_y_deg", type=float, help="Degrees; positive lifts the left side.")
@click.option("--yaw", "yaw_deg", type=float, help="Turn about the vertical in degrees.")
@_wait
@json_option
@click.pass_obj
def specimen(session: Session, /, object_: str | None, wait: bool, as_json: bool, **args: Any) -> None:
    """Lay something else under the simulated camera, or tilt it; what is left out stays."""
    with session.client() as client:
        result, _ = _run(client, "specimen", {"object": object_, **args}, wait=wait)
    _show("specimen", result, as_json)


COMMANDS: tuple[click.Command, ...] = (goto, jog, home, zero, lamp, camera, prescan, specimen, control)
