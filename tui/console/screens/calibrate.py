"""The calibrate screen: board views and sweeps collected under guidance, and what came of them with its reasons."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import Any

from rich.text import Text
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.message import Message

from acquire.contract.errors import CalibrationError
from tui.console.calibration.board_sweeps import BoardSweeps
from tui.console.calibration.board_watch import BoardWatch
from tui.console.calibration.light_setup import BringLight, Command
from tui.console.calibration.rules import (
    CAMERA_GOAL,
    PLANE_GOAL,
    PLANE_POSES,
    POSES,
    Situation,
    camera_hint,
    plane_hint,
    why_not,
)
from tui.console.calibration.session import BoardWords, CalibrationSession, parse_board
from tui.console.calibration.texts import Verdict, verdict_of
from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.screens.calibrate_keys import BINDINGS
from tui.console.screens.camera_screen import CameraScreen
from tui.console.screens.dialogs import Field, Form
from tui.console.widgets.board_picture import BoardPicture
from tui.console.widgets.calibrate_panes import GuidePane, GuideView
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.rows import RowList
from tui.processes.child_jobs import Job
from tui.scans.folder import ScanFolder
from tui.text.status_text import is_running

LOOK_S = 2.0


@dataclass
class BoardSeen(Message):
    """News of the child that looks for the board."""

    facts: dict[str, Any]


class CalibrateScreen(CameraScreen):
    """Camera first, then the light plane."""

    NAME = "calibrate"
    SUMMARY = (
        "First the camera: pictures of a board in different tilts, one of them lying flat. Then the light plane: "
        "sweeps over the board flat and tilted. Nothing replaces a calibration in use by itself."
    )
    CHANGES = frozenset({"capture", "sweep", "pose", "object"}) | CameraScreen.OF_CAMERA
    BINDINGS = BINDINGS
    DEFAULT_CSS = """
    CalibrateScreen #panes { height: 1fr; }
    CalibrateScreen BoardPicture, CalibrateScreen #sweeps { width: 1fr; }
    CalibrateScreen GuidePane { width: 38; }
    CalibrateScreen.wide GuidePane { width: 60; }
    """

    def __init__(self, *, ascii_only: bool = False) -> None:
        super().__init__(ascii_only=ascii_only)
        self._picture = BoardPicture("mono" if ascii_only else "half", ascii_only=ascii_only)
        self._list = RowList(id="sweeps", ascii_only=ascii_only, empty="no calibration sweep yet: w takes one")
        self._guide = GuidePane(ascii_only=ascii_only)
        self._jobs = JobLines(ascii_only=ascii_only)
        self._session: CalibrationSession | None = None
        self._scans: ScanFolder | None = None
        self._sweeps = BoardSweeps()
        self._plane_step = False
        self._verdicts: dict[bool, Verdict] = {}
        self._show_verdict = False
        self._watch = BoardWatch(lambda: self.shell.jobs, lambda facts: self.post_message(BoardSeen(facts)))
        self._light = BringLight()
        self._pose = 0

    def body(self) -> ComposeResult:
        """The picture or the sweeps, the guidance, what runs."""
        yield Horizontal(self._picture, self._list, self._guide, id="panes")
        yield self._jobs

    def on_mount(self) -> None:
        """Go on with the newest session."""
        data_dir = self.shell.options.data_dir
        self._session, self._scans = CalibrationSession(data_dir), ScanFolder(data_dir)
        self.set_interval(LOOK_S, self._look)

    def on_screen_suspend(self) -> None:
        """Nobody looks: nothing is looked for, and no search begins when the light arrives."""
        self._watch.stop()
        self._light.forget()

    # ---- news ----

    def show(self, view: RigView) -> None:
        """Picture or sweeps, and the guidance."""
        if self._session is None:
            return
        self._picture.display, self._list.display = not self._plane_step, self._plane_step
        self._show_picture(view)
        self._show_sweeps()
        self._guide.border_title = "2 of 2: light plane" if self._plane_step else "1 of 2: camera"
        self._guide.show(self._guide_view(view))
        self._jobs.show(self.shell.jobs.work)
        if view.status is not None:
            self._send_all(self._light.heard(view.status, self.shell.now_s(), stopped=bool(view.stop_words)))
        self._watch.follow(self._session.watch_command(), wanted=self._wanted(view))

    def _show_picture(self, view: RigView) -> None:
        if not view.connected:
            self._picture.show(None, "not connected - retrying")
        elif view.picture is None:
            self._picture.show(None, "no picture yet: p turns the preview on")
        elif self.shell.meter.may_send_picture():
            self._picture.show(view.picture, "", self.shell.meter.governor.detail)
        self._picture.mark(self._watch.live.get("corners") or () if view.connected else ())

    def _show_sweeps(self) -> None:
        self._list.border_title = "sweeps over the board"
        self._list.show(Text("use  sweep"), self._sweeps.rows(ascii_only=self.ascii_only), self._sweeps.keys)

    def _guide_view(self, view: RigView) -> GuideView:
        assert self._session is not None
        verdict = self._verdicts.get(self._plane_step) if self._show_verdict else None
        board = self._session.board.words()
        if self._plane_step:
            hint = plane_hint(len(self._sweeps.used))
            return GuideView(PLANE_GOAL, board, hint=hint, verdict=verdict)
        wanted, status = self._wanted(view), view.status
        hint = ""
        if wanted and verdict is None:
            hint = camera_hint(lamp_on=status is not None and status.lamp_on, views=len(self._session.views))
        live = self._watch.words(wanted=wanted) if verdict is None else ""
        return GuideView(CAMERA_GOAL, board, live=live, facts=self._watch.facts, verdict=verdict, hint=hint)

    def _look(self) -> None:
        """The sweeps of the folder, now and then."""
        if self.is_current and self._plane_step and self._scans is not None:
            self.run_worker(self._look_at(self._scans), exclusive=True, exit_on_error=False)

    async def _look_at(self, scans: ScanFolder) -> None:
        try:
            found = await asyncio.to_thread(scans.look)
        except CalibrationError:
            return
        self._sweeps.take(found)
        self.show_all(self.view)

    # ---- looking for the board ----

    def _wanted(self, view: RigView) -> bool:
        looks = self.is_current and not self._plane_step
        return looks and view.connected and view.status is not None and not is_running(view.status)

    def on_board_seen(self, message: BoardSeen) -> None:
        """What the child found."""
        self._watch.take(message.facts)
        self.show_all(self.view)

    # ---- what can be done ----

    def why_not(self, action: str) -> str:
        """The step and the rig's state decide."""
        if self._session is None:
            return "the screen is being made"
        status = self.view.status
        situation = Situation(
            plane_step=self._plane_step,
            sweep_runs=is_running(status),
            simulated=status is not None and status.camera_kind == "simulated",
            views=len(self._session.views),
            sweeps=len(self._sweeps.entries),
            used=len(self._sweeps.used),
            has_camera=self._session.result.is_file(),
            has_verdict=self._plane_step in self._verdicts,
            works=self.shell.jobs.board.running_on(str(self._session.folder)) is not None,
        )
        return why_not(action, situation) or super().why_not(action)

    def goto_first_offers(self) -> int:
        """Where the sweep ends the light lies over all of the board; beyond it, its edge lies no more on a view."""
        assert self.view.status is not None
        return self.shell.draft.last_steps if self._plane_step else self.view.status.travel_steps[1]

    def action_expose(self) -> None:
        """Search the exposure once; for a sweep with the light over all of the board."""
        if not self._plane_step:
            super().action_expose()
            return
        assert self.view.status is not None
        self._send_all(self._light.begin(self.shell.draft.last_steps, self.view.status, self.shell.now_s()))

    def _send_all(self, commands: list[Command]) -> None:
        def answered(answer: CommandAnswered) -> None:
            if not answer.ok:
                self._light.forget()
                self.say(f"{answer.name}: {answer.detail}", "error")

        for name, args in commands:
            self.send(name, answered, **args)

    def action_board(self) -> None:
        """Ask what the board is."""
        assert self._session is not None
        board = self._session.board
        fields = [
            Field("squares", "squares", f"{board.columns}x{board.rows}", help="along both sides, or dots: 16x13"),
            Field("square_mm", "size in mm", f"{board.square_mm:g}", help="side of a square, or distance of two dots"),
            Field("kind", "kind", board.kind, help="chessboard, charuco or dots"),
        ]
        self.shell.push_screen(Form("the board", fields, parse_board), self._keep_board)

    def _keep_board(self, board: BoardWords | None) -> None:
        if board is None or self._session is None:
            return
        try:
            self._session.keep_board(board)
        except CalibrationError as error:
            self.say(str(error), "error")
        self._look_anew()

    def _look_anew(self) -> None:
        """The child begins again with what is asked for now."""
        self._watch.begin_anew()
        self.show_all(self.view)

    def action_capture(self) -> None:
        """Keep this view."""
        assert self._session is not None
        path = self._session.next_view()

        def answered(answer: CommandAnswered) -> None:
            self.say(f"{path.name}: " + ("captured" if answer.ok else answer.detail), "info" if answer.ok else "error")

        self._show_verdict = False
        self.send("capture", answered, path=str(path.absolute()))

    def action_undo(self) -> None:
        """Put the last view aside."""
        assert self._session is not None
        try:
            self.say(f"{self._session.drop_last_view()} was put aside")
        except CalibrationError as error:
            self.say(str(error), "error")

    def action_anew(self) -> None:
        """An empty session."""
        assert self._session is not None
        self._session.begin_anew()
        self._verdicts, self._show_verdict = {}, False
        self.say(f"a new calibration: {self._session.folder}; the one before stays")
        self._look_anew()

    def action_step(self) -> None:
        """Camera, light plane."""
        self._plane_step = not self._plane_step
        self._pose = 0  # the simulated board begins flat again
        self._show_verdict = self._plane_step in self._verdicts
        self.show_all(self.view)
        self._look()

    def action_verdict(self) -> None:
        """The result or the guidance."""
        self._show_verdict = not self._show_verdict
        self.show_all(self.view)

    def action_move(self, rows: int) -> None:
        """Choose another sweep."""
        self._list.move(rows)

    def action_use(self) -> None:
        """Whether the chosen sweep counts."""
        self._sweeps.toggle(str(self._list.chosen))
        self.show_all(self.view)

    def action_sweep(self) -> None:
        """Sweep over the board as it lies."""
        draft = self.shell.draft
        self.send("scan", name=f"board-{len(self._sweeps.entries) + 1}", **draft.plan_args(), purpose="calibration")

    def action_pose(self) -> None:
        """The simulated board in the next pose."""
        poses = PLANE_POSES if self._plane_step else POSES
        pose = poses[self._pose % len(poses)]
        self._pose += 1
        self.send("specimen", object="checkerboard", **pose)

    def action_object(self) -> None:
        """The specimen back under the simulated camera."""
        self._pose = 0
        self.send("specimen", object="stirrup", tilt_x_deg=0.0, tilt_y_deg=0.0, moved_um=[0.0, 0.0, 0.0])

    def action_cancel(self) -> None:
        """End the calibration."""
        assert self._session is not None
        job = self.shell.jobs.board.running_on(str(self._session.folder))
        if job is not None:
            self.shell.jobs.cancel(job)

    def action_fit(self) -> None:
        """Calibrate with what was collected."""
        assert self._session is not None
        session, plane = self._session, self._plane_step
        self._show_verdict = False
        before = session.document_before().get("camera") or {}

        def ended(job: Job) -> None:
            if not job.cancelled:
                self._verdicts[plane] = verdict_of(job, before, plane=plane)
                self._show_verdict = True
                self.say(self._verdicts[plane].headline, "info" if self._verdicts[plane].passed else "error")
            self.show_all(self.view)

        stage = str(self._watch.facts.get("stage_view") or "")
        command = session.plane_command(self._sweeps.used) if plane else session.camera_command(stage)
        title = "calibrate the light plane" if plane else "calibrate the camera"
        self.shell.jobs.start(title, command, str(session.folder), ended)
