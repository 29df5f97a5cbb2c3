"""The subcommand that searches the board in the preview while views are captured, and says which are missing."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from tui.commands.calibrate.shared import board_of, views_options
from tui.commands.context import PATH, Session, json_option, print_json

if TYPE_CHECKING:
    from process.calibration.board.detection import Board
    from process.calibration.board.guidance import ViewFacts

MOST_AT_ONCE = 100
PAUSE_S = 0.2
"""Pause between two detections: they must not take processor time from a worker."""


@click.command()
@views_options
@click.option("--views", type=PATH, help="Folder of the views captured so far.")
@click.option("--once", is_flag=True, help="Evaluate the views and end, without the camera.")
@json_option
@click.pass_obj
def watch(
    session: Session,
    squares: tuple[int, int],
    square_mm: float,
    kind: str,
    dictionary: str,
    legacy_layout: bool | None,
    views: Path | None,
    once: bool,
    as_json: bool,
) -> None:
    """Detect the board in the camera's preview.

    Runs until Ctrl-C; each line describes the pose of the board, what the captured views cover, and which view is
    missing. Turn the preview on first (the console's calibrate screen does)."""
    import os

    os.nice(5)
    board = board_of(squares, square_mm, kind, dictionary, legacy_layout)
    collected = CapturedViews(board, views)
    say = print_json if as_json else _say_words
    if once:
        collected.look()
        say(collected.facts(None))
        return
    _watch(session, collected, say)


class CapturedViews:
    """The captured views of a folder; the board is searched once in each."""

    def __init__(self, board: Board, folder: Path | None) -> None:
        self._board, self._folder = board, folder
        self._known: dict[tuple[str, int], ViewFacts] = {}

    def look(self) -> bool:
        """Read new views; True if the set of views has changed."""
        from natsort import natsorted

        before = set(self._known)
        found: dict[tuple[str, int], ViewFacts] = {}
        folder = self._folder
        paths = natsorted(folder.glob("*.png")) if folder is not None and folder.is_dir() else []
        for path in paths:
            if path.name.startswith(".") or not path.is_file():
                continue
            key = (path.name, path.stat().st_mtime_ns)
            found[key] = self._known.get(key) or self._read(path)
        self._known = found
        return set(found) != before

    def _read(self, path: Path) -> ViewFacts:
        from acquire.pictures.names import readable
        from acquire.pictures.reader import PictureError, read_grey
        from process.calibration.board.guidance import ViewFacts, assess_view

        try:
            pixels = read_grey(path)
        except PictureError as error:
            return ViewFacts(readable(path.name), found=False, reason=f"it {error.why}")
        return assess_view(readable(path.name), pixels, self.settled(pixels))

    def settled(self, pixels: Any) -> Board:
        """The board, with the dictionary of its markers as soon as a picture has shown it."""
        from process.calibration.board.detection import settled

        self._board = settled(self._board, [pixels])
        return self._board

    def facts(self, live: ViewFacts | None) -> dict[str, Any]:
        """All facts that the console shows."""
        from process.calibration.board.guidance import guide, live_advice

        views = list(self._known.values())
        found = guide(views)
        return {
            "views": [
                {"name": view.name, "found": view.found, "words": view.text(), "tilt_deg": round(view.tilt_deg, 1)}
                for view in views
            ],
            "coverage": found.coverage,
            "advice": found.advice,
            "ready": found.ready,
            "stage_view": found.stage_view,
            "live": None
            if live is None
            else {"found": live.found, "corners": live.corners, "words": live_advice(live, views)},
        }


def _watch(session: Session, collected: CapturedViews, say: Any) -> None:
    import time

    import zmq

    from acquire.contract.messaging.lanes import arrived, connect
    from acquire.contract.messaging.messages import Picture
    from acquire.contract.process.run_dir import client_run_dir
    from acquire.contract.rig_client.feed import picture_pixels
    from process.calibration.board.guidance import assess_view

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
                pixels = picture_pixels(newest.message, newest.buffer)
                live = assess_view("live", pixels, collected.settled(pixels))
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
    click.echo("\n".join(facts["advice"]) or "the views suffice: run 'sweepscope calibrate camera'")
