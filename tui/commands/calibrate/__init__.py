"""Subcommands of calibration: camera, response, three methods for the light plane, checks, import."""

from __future__ import annotations

import click

from .board import board
from .camera import camera
from .checks import check, rezero
from .original import import_original
from .plane import plane, reference_planes, refit
from .quarter_circle import quarter_circle
from .response import response
from .watch import watch


@click.group()
def calibrate() -> None:
    """Calibrate camera and light plane, and check them."""


for _command in (
    camera,
    response,
    plane,
    refit,
    quarter_circle,
    reference_planes,
    check,
    rezero,
    watch,
    import_original,
):
    calibrate.add_command(_command)

COMMANDS: tuple[click.Command, ...] = (calibrate, board)
