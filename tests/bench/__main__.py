"""Runs one benchmark and prints its figures, as lines or as one JSON object."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from typing import Any

import click

from acquire.contract.errors import SweepscopeError
from tui.commands.context import json_option, plain, print_json
from tui.text.sizes import parse_size


def _size(_context: click.Context, _parameter: click.Parameter, value: str) -> tuple[int, int]:
    try:
        return parse_size(value)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


_frames = click.option("--frames", type=click.IntRange(2, 100_000), default=527, show_default=True)
_pixels = click.option("--size", metavar="WxH", default="1024x768", show_default=True, callback=_size)


@click.group(context_settings={"help_option_names": ["-h", "--help"]})
def bench() -> None:
    """Measure this machine, as ratios to a plain copy in memory."""


@bench.command()
@_frames
@_pixels
@json_option
def fold(frames: int, size: tuple[int, int], as_json: bool) -> None:
    """Fold a synthetic sweep frame by frame."""
    from tests.bench.fold import bench_fold

    _show(bench_fold((size[1], size[0]), frames), as_json)


@bench.command()
@_frames
@_pixels
@click.option("--pictures", is_flag=True, help="Send pictures to a subscriber meanwhile, as a console asks for them.")
@json_option
def pipeline(frames: int, size: tuple[int, int], pictures: bool, as_json: bool) -> None:
    """Push a synthetic sweep through real writer and worker processes."""
    from tests.bench.pipeline import bench_pipeline

    _show(bench_pipeline(frames, (size[1], size[0]), pictures=pictures), as_json)


@bench.command()
@_frames
@json_option
def stage(frames: int, as_json: bool) -> None:
    """Measure the stage's firmware and serial link in the emulator (needs the AVR tools)."""
    from tests.bench.stage import bench_stage

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
    from tests.bench.estimates import bench_clipped, bench_estimates, bench_fit_speed, markdown

    if speed:
        _show(bench_fit_speed(), as_json)
        return
    cases = list(bench_clipped(pixels) if clipped else bench_estimates(pixels))
    if as_json:
        print_json([case._asdict() for case in cases])
        return
    click.echo(markdown(cases))


@bench.command()
@click.option("--columns", type=click.IntRange(60, 400), default=100, show_default=True)
@click.option("--rows", type=click.IntRange(20, 200), default=30, show_default=True)
@json_option
def console(columns: int, rows: int, as_json: bool) -> None:
    """Measure the console in tmux during a sweep, and on a stuck and a slow terminal (takes two minutes)."""
    from tests.bench.console import bench_console

    _show(bench_console((columns, rows)), as_json)


@bench.command()
@click.option("--demo", is_flag=True, help="During a demonstration sweep instead of 2 million points at once.")
def page(demo: bool) -> None:
    """Measure what the viewer's page sends to one browser."""
    from tests.bench.page import LINK_BYTES_PER_S, bench_demo, bench_points

    if demo:
        bench_demo()
        return
    for bound in LINK_BYTES_PER_S:
        click.echo(bench_points(bound))


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


if __name__ == "__main__":
    try:
        bench(prog_name="python -m tests.bench")
    except SweepscopeError as failure:
        sys.exit(f"bench: {failure}")
