"""Subcommands beside the rig: the effective configuration, benchmarks, the version."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import click

from tui.commands.context import Session, json_option, plain, print_json


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


@click.group()
def bench() -> None:
    """Measure this machine, as ratios to a plain copy in memory."""


def _size(_context: click.Context, _parameter: click.Parameter, value: str) -> tuple[int, int]:
    from tui.text.sizes import parse_size

    try:
        return parse_size(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


_frames = click.option("--frames", type=click.IntRange(2, 100_000), default=527, show_default=True)
_pixels = click.option("--size", metavar="WxH", default="1024x768", show_default=True, callback=_size)


@bench.command()
@_frames
@_pixels
@json_option
def fold(frames: int, size: tuple[int, int], as_json: bool) -> None:
    """Fold a synthetic sweep frame by frame."""
    from process.bench.fold import bench_fold

    _show(bench_fold((size[1], size[0]), frames), as_json)


@bench.command()
@_frames
@_pixels
@click.option("--pictures", is_flag=True, help="Show pictures to a subscriber meanwhile, as a console asks for them.")
@json_option
def pipeline(frames: int, size: tuple[int, int], pictures: bool, as_json: bool) -> None:
    """Push a synthetic sweep through real writer and worker processes."""
    from acquire.bench.pipeline import bench_pipeline

    _show(bench_pipeline(frames, (size[1], size[0]), pictures=pictures), as_json)


@bench.command()
@_frames
@json_option
def stage(frames: int, as_json: bool) -> None:
    """Measure the stage's firmware and serial link in the emulator (needs the AVR tools)."""
    from acquire.bench.stage import bench_stage

    _show(bench_stage(frames), as_json)


@bench.command()
@click.option(
    "--pixels", type=click.IntRange(16, 1_000_000), default=16_000, show_default=True, help="Per kind of edge."
)
@click.option("--clipped", is_flag=True, help="Edges whose plateau lies beyond full scale instead.")
@click.option("--speed", is_flag=True, help="Time the whole-edge fit of a 1024 x 768 x 527 scan instead.")
@json_option
def estimates(pixels: int, speed: bool, clipped: bool, as_json: bool) -> None:
    """Compare the crossing estimates with the Cramer-Rao bound; prints the table of docs/accuracy.md."""
    from process.bench.edge_fit import bench_clipped, bench_estimates, bench_fit_speed, markdown

    if speed:
        _show(bench_fit_speed(), as_json)
        return
    cases = list(bench_clipped(pixels) if clipped else bench_estimates(pixels))
    if as_json:
        print_json([case._asdict() for case in cases])
        return
    click.echo(markdown(cases))


@bench.command("console")
@click.option("--columns", type=click.IntRange(60, 400), default=100, show_default=True)
@click.option("--rows", type=click.IntRange(20, 200), default=30, show_default=True)
@json_option
def bench_of_console(columns: int, rows: int, as_json: bool) -> None:
    """Measure the console in tmux during a sweep, and on a stuck and a slow line (takes two minutes)."""
    from tui.bench.console import bench_console

    _show(bench_console((columns, rows)), as_json)


def _show(figures: object, as_json: bool) -> None:
    if as_json:
        print_json(figures)
        return
    for name, value in _flat(plain(figures)):
        click.echo(f"{name.replace('_', ' '):<40} {f'{value:.4g}' if isinstance(value, float) else value}")


def _flat(figures: dict[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in figures.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}  ")
        else:
            yield prefix + name, value


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


COMMANDS: tuple[click.Command, ...] = (config, bench, version)
