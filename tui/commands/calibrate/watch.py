"""The subcommand that looks for the board in the preview while views are collected, and says what is missing."""

# ruff: noqa: PLC0415 - imports happen when a command runs, so that --help is quick

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tui.commands.calibrate.options import PATH, board_of, size_option
from tui.commands.context import Session, json_option, print_json

if TYPE_CHECKING:
    from process.calibration.board.detection import Board
    from process.calibration.board.guidance import ViewFacts

MOST_AT_ONCE = 100
PAUSE_S = 0.2
"""Rest between two looks: detection must not take the machine from a worker."""


@click.command()
@click.option("--squares", required=True, metavar="CxR", callback=size_option, help="Squares (or dots) of the board.")
@click.option("--square-mm", required=True, type=float, help="Side of a square, or distance of two dots, in mm.")
@click.option("--kind", type=click.Choice(["chessboard", "charuco", "dots"]), default="chessboard", show_default=True)
@click.option("--views", type=PATH, help="Folder of the views captured so far.")
@click.option("--once", is_flag=True, help="Judge the views and end, without looking at the camera.")
@json_option
@click.pass_obj
def watch(
    session: Session,
    squares: tuple[int, int],
    square_mm: float,
    kind: str,
    views: Path | None,
    once: bool,
    as_json: bool,
) -> None:
    """Look for the board in the camera's preview, and say which view is missing.

    Runs until Ctrl-C; each line says how the board lies now, what the views in the folder cover, and what to do next.
    Turn the preview on first (the console's calibrate screen does)."""
    import os

    os.nice(5)
    board = board_of(squares, square_mm, kind)
    collected = Views(board, views)
    say = print_json if as_json else _say_words
    if once:
        collected.look()
        say(collected.facts(None))
        return
    _watch(session, board, collected, say)


class Views:
    """The captured views of a folder; each is looked at once."""

    def __init__(self, board: Board, folder: Path | None) -> None:
        self._board, self._folder = board, folder
        self._known: dict[tuple[str, int], ViewFacts] = {}

    def look(self) -> bool:
        """Look at what is new; True if anything has changed."""
        from natsort import natsorted

        before = set(self._known)
        found: dict[tuple[str, int], ViewFacts] = {}
        folder = self._folder
        paths = natsorted(folder.glob("*.png")) if folder is not None and folder.is_dir() else []
        for path in paths:
            if path.name.startswith("."):
                continue
            key = (path.name, path.stat().st_mtime_ns)
            found[key] = self._known.get(key) or self._read(path)
        self._known = found
        return set(found) != before

    def _read(self, path: Path) -> ViewFacts:
        import cv2

        from process.calibration.board.guidance import ViewFacts, look

        pixels = cv2.imread(str(path), cv2.IMREAD_ANYDEPTH | cv2.IMREAD_GRAYSCALE | cv2.IMREAD_IGNORE_ORIENTATION)
        if pixels is None:
            return ViewFacts(path.name, found=False, reason="it is no picture that can be read")
        return look(path.name, pixels, self._board)

    def facts(self, live: ViewFacts | None) -> dict[str, Any]:
        """Everything that a screen shows."""
        from process.calibration.board.guidance import guide, live_words

        views = list(self._known.values())
        found = guide(views)
        return {
            "views": [
                {"name": view.name, "found": view.found, "words": view.words(), "tilt_deg": round(view.tilt_deg, 1)}
                for view in views
            ],
            "coverage": found.coverage,
            "advice": found.advice,
            "ready": found.ready,
            "stage_view": found.stage_view,
            "live": None
            if live is None
            else {"found": live.found, "corners": live.corners, "words": live_words(live, views)},
        }


def _watch(session: Session, board: Board, collected: Views, say: Any) -> None:
    import time

    import zmq

    from acquire.contract.messaging.lanes import arrived, connect
    from acquire.contract.messaging.messages import Picture
    from acquire.contract.process.run_dir import client_run_dir
    from acquire.contract.rig_client.feed import picture_pixels
    from process.calibration.board.guidance import look

    context: zmq.Context[Any] = zmq.Context()
    socket = connect(context, zmq.SUB, client_run_dir(), "preview")
    try:
        while True:
            changed = collected.look()
            socket.poll(500)
            newest = None
            for newest in arrived(socket, MOST_AT_ONCE):  # noqa: B007 - the last one is wanted
                pass
            live = None
            if newest is not None and isinstance(newest.message, Picture):
                live = look("live", picture_pixels(newest.message, newest.buffer), board)
            if live is not None or changed:
                say(collected.facts(live))
            time.sleep(PAUSE_S)
    finally:
        context.destroy(linger=0)


def _say_words(facts: dict[str, Any]) -> None:
    if facts["live"] is not None:
        click.echo(facts["live"]["words"])
        return
    for view in facts["views"]:
        click.echo(f"{view['name']}: {view['words']}")
    for row in facts["coverage"]:
        click.echo("  " + " ".join(f"{count:>2}" for count in row))
    click.echo("\n".join(facts["advice"]) or "there is enough: 'sweepscope calibrate camera' can begin")
