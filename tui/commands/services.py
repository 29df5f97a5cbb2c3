"""Subcommands that start processes: the four services, all of them at once (`up`), the console, the demonstration."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import click

from tui.commands.context import PATH, TEXT, Number, Session, remote_options, size_callback


@click.command()
@click.pass_obj
def daemon(session: Session) -> None:
    """Control stage, camera and lamp, and run sweeps."""
    session.begin_service("daemon")
    from acquire.daemon.service import run_daemon

    run_daemon(session.config(), session.service_run_dir())


@click.command()
@click.pass_obj
def writer(session: Session) -> None:
    """Write frames into the scan file."""
    session.begin_service("writer")
    from acquire.writer.service import run_writer

    run_writer(session.config(), session.service_run_dir())


@click.command()
@click.pass_obj
def worker(session: Session) -> None:
    """Turn frames into maps and a point cloud while they arrive."""
    session.begin_service("worker")
    from process.worker.service import run_worker

    run_worker(session.config(), session.service_run_dir())


@click.command()
@click.option("--port", type=click.IntRange(0, 65_535), help="TCP port of the page; 0 takes any free one.")
@click.pass_obj
def viewer(session: Session, port: int | None) -> None:
    """Show the cloud and the rig in a browser."""
    session.begin_service("viewer")
    from process.viewer.service import run_viewer

    run_viewer(session.config(), session.service_run_dir(), port=port)


@click.group(invoke_without_command=True)
@click.option(
    "--ascii", "ascii_only", is_flag=True, help="Draw with ASCII characters only [where the locale needs it]."
)
@click.option("--read-only", is_flag=True, help="Watch only: no action that moves or changes the rig, except STOP.")
@remote_options
@click.option("--picture", type=click.Choice(["half", "mono", "off"]), help="How the camera picture is drawn.")
@click.option(
    "--color",
    "colours",
    type=click.Choice(["auto", "truecolor", "256", "16", "none"]),
    default="auto",
    show_default=True,
    help="Colours to use; auto asks COLORTERM, TERM and NO_COLOR.",
)
@click.option("--theme", type=click.Choice(["dark", "light", "contrast"]), default="dark", show_default=True)
@click.option("--mouse", is_flag=True, help="Keys, screens and lists can be clicked; never needed.")
@click.pass_context
def console(
    context: click.Context,
    ascii_only: bool,
    read_only: bool,
    picture: str | None,
    colours: str,
    theme: str,
    mouse: bool,
) -> int:
    """Show and control the rig in this terminal.

    Closing it never affects a sweep: reopen it at any time."""
    if context.invoked_subcommand is not None:
        return 0
    from tui.console.terminal.terminal import choose_colours, needs_ascii, picture_mode, require_terminal

    require_terminal("the console")
    ascii_only = ascii_only or needs_ascii()
    config = context.obj.config()  # an invalid rig.toml is reported before the screen is drawn
    settled = choose_colours(colours)
    from tui.console.options import options_for
    from tui.console.run import run_console

    options = dataclasses.replace(
        options_for(config),
        ascii_only=ascii_only,
        read_only=read_only,
        mouse=mouse,
        picture=picture or picture_mode(settled, ascii_only=ascii_only),
        theme=f"sweepscope-{theme}",
    )
    with context.obj.tunnel() as remote_dir:
        return run_console(options, run_dir=remote_dir)


@console.command("doctor")
def console_doctor() -> int:
    """Check this terminal and its connection, and suggest fixes."""
    from tui.console.terminal.terminal import require_terminal

    require_terminal("the console's doctor")
    from tui.console.terminal.doctor import examine

    return 1 if examine(click.echo) else 0


@click.command()
@click.pass_obj
def up(session: Session) -> int:
    """Run the four services until Ctrl-C.

    Daemon, writer, worker and viewer; one that dies is restarted."""
    from tui.processes.all_services import run_up

    return run_up(session.config(), session.config_path, session.service_run_dir())


@click.command()
@click.option("--size", metavar="WxH", callback=size_callback, hidden=True, help="Pixels of the simulated camera.")
@click.option("--frames", type=click.IntRange(2, 100_000), hidden=True, help="Frames over the whole travel.")
@click.option("--time-scale", type=Number(0, 1000, min_open=True), hidden=True, help="Factor on simulated durations.")
@click.option("--object", "specimen", type=TEXT, hidden=True, help="Simulated specimen.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), hidden=True)
@click.option(
    "--rate", "max_rate_hz", type=Number(0, 10_000, min_open=True), hidden=True, help="Frames per second at most."
)
@click.option("--data-dir", type=PATH, default=Path("demo-data"), hidden=True)
@click.option("--twin", is_flag=True, help="Run the real firmware in an emulator (needs the AVR tools).")
def demo(**settings: Any) -> int:
    """Take a whole scan on a simulated rig.

    On a terminal the console opens and the sweep starts at once; without one progress is printed. Scans go to
    ./demo-data. No configuration file is read and no hardware is touched.
    """
    from tui.demo.rig import DemoOptions
    from tui.demo.run import run_demo

    return run_demo(DemoOptions(**settings))


COMMANDS: tuple[click.Command, ...] = (demo, up, console, daemon, writer, worker, viewer)
