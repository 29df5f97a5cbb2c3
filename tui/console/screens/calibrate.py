"""The calibrate screen: board views and sweeps collected under guidance, and the results with their reasons."""

from __future__ import annotations

from rich.text import Text
from textual.app import ComposeResult
from textual.binding import Binding
from textual.containers import Horizontal

from acquire.contract.errors import SweepscopeError
from tui.console.calibration.board_watch import BoardWatch
from tui.console.calibration.light_setup import CommandCall, LightSetup
from tui.console.calibration.progress import CalibrationProgress
from tui.console.calibration.rules import CAMERA_GOAL, PLANE_GOAL, camera_hint, plane_hint, why_not
from tui.console.calibration.session import BoardPattern, parse_board
from tui.console.jobs import Job
from tui.console.link.messages import CommandAnswered
from tui.console.link.rig_view import RigView
from tui.console.screens.camera_screen import CameraScreen
from tui.console.screens.dialogs import FormDialog, FormField
from tui.console.screens.scan_list import ScanList
from tui.console.shell import Shell
from tui.console.widgets.board_picture import BoardPicture
from tui.console.widgets.calibrate_panes import GuidePane, GuideView
from tui.console.widgets.job_lines import JobLines
from tui.console.widgets.rows import RowList, Rows
from tui.text.status_text import is_running


class CalibrateScreen(CameraScreen):
    """Camera first, then the light plane."""

    NAME = "calibrate"
    SUMMARY = (
        "First the camera: pictures of a board in different tilts, one of them lying flat. Then the light plane: "
        "sweeps over the board flat and tilted. The calibration in use is never replaced by itself."
    )
    CHANGES = frozenset({"capture", "sweep", "pose", "object"}) | CameraScreen.OF_CAMERA
    BINDINGS = [
        Binding("p", "preview", "preview", id="calibrate.preview", tooltip="camera pictures on or off"),
        Binding("L", "lamp", "lamp", id="calibrate.lamp", tooltip="lamp on or off"),
        Binding("t", "goto", "go to", id="calibrate.goto", tooltip="move the light to a position"),
        Binding("b", "board", "board", id="calibrate.board", tooltip="squares, their size, kind"),
        Binding("c", "capture", "capture", id="calibrate.capture", tooltip="save this view in full size"),
        Binding("u", "undo", "drop last", id="calibrate.undo", tooltip="drop the last view"),
        Binding("g", "fit", "calibrate", id="calibrate.fit", tooltip="calibrate with what was collected"),
        Binding("m", "step", "next step", id="calibrate.step", tooltip="camera, light plane"),
        Binding("w", "sweep", "sweep", id="calibrate.sweep", tooltip="sweep over the board as it lies now"),
        Binding("e", "expose", "expose", id="calibrate.expose", tooltip="search the exposure (sweep: light on board)"),
        Binding("enter", "use", "use or not", id="calibrate.use", tooltip="whether a sweep is used"),
        Binding("v", "result", "result", id="calibrate.verdict", tooltip="the last result, or the guidance"),
        Binding("n", "anew", "start over", id="calibrate.anew", tooltip="an empty session; this one stays"),
        Binding("x", "cancel", "cancel", id="calibrate.cancel", tooltip="cancel the running calibration"),
        Binding("P", "pose", "next pose", id="calibrate.pose", tooltip="simulated rig: the board in another pose"),
        Binding("O", "object", "take board off", id="calibrate.object", tooltip="simulated rig: the specimen back"),
        Binding("up", "move(-1)", "previous", show=False),
        Binding("down", "move(1)", "next", show=False),
    ]
    DEFAULT_CSS = """
    CalibrateScreen #panes { height: 1fr; }
    CalibrateScreen BoardPicture, CalibrateScreen RowList { width: 1fr; }
    CalibrateScreen GuidePane { width: 38; }
    CalibrateScreen.wide GuidePane { width: 60; }
    """

    def __init__(self, shell: Shell) -> None:
        super().__init__(shell)
        self._picture = BoardPicture("mono" if shell.options.ascii_only else "half")
        self._list = RowList(empty="no calibration sweep yet: w takes one")
        self._list.border_title = "sweeps over the board"
        self._guide = GuidePane(GuideView())
        self._job_lines = JobLines(())
        self._scans = ScanList(self, self._take_scans)
        self._progress = CalibrationProgress(shell.options.data_dir)
        self._watch = BoardWatch(self.jobs, lambda: self.show_all(self.view))
        self._light = LightSetup()

    def body(self) -> ComposeResult:
        """The picture or the sweeps, the guide, running jobs."""
        yield Horizontal(self._picture, self._list, self._guide, id="panes")
        yield self._job_lines

    def on_mount(self) -> None:
        """List the sweeps, again and again."""
        self._scans.begin()

    def on_screen_suspend(self) -> None:
        """Hidden: do not look for the board, nor search the exposure when the light arrives."""
        self._watch.stop()
        self._light.forget()

    # ---- what is shown ----

    def show(self, view: RigView) -> None:
        """Picture or sweeps, and the guide."""
        plane, sweeps = self._progress.plane_step, self._progress.sweeps
        self._picture.display, self._list.display = not plane, plane
        self._show_picture(view)
        self._list.show(Rows(Text("use  sweep"), sweeps.rows(), sweeps.keys))
        self._guide.border_title = "2 of 2: light plane" if plane else "1 of 2: camera"
        self._guide.show(self._guide_view(view))
        self._job_lines.show(self.jobs.work)
        if view.status is not None:
            self._send_all(self._light.take_status(view.status, self.shell.now_s(), stopped=bool(view.stop_words)))
        self._watch.follow(self._progress.session.watch_command(), wanted=self._looks_for_board(view))

    def _show_picture(self, view: RigView) -> None:
        if not view.connected:
            self._picture.show(None, "not connected - retrying")
        elif view.picture is None:
            self._picture.show(None, "no picture yet: p starts the preview")
        elif self.shell.meter.may_send_picture():
            self._picture.show(view.picture, "", self.shell.meter.rate.detail)
        self._picture.mark(self._watch.live.get("corners") or () if view.connected else ())

    def _guide_view(self, view: RigView) -> GuideView:
        session, result = self._progress.session, self._progress.result
        board = session.board.words()
        if self._progress.plane_step:
            return GuideView(PLANE_GOAL, board, hint=plane_hint(len(self._progress.sweeps.used)), result=result)
        looks, status = self._looks_for_board(view), view.status
        live = hint = ""
        if result is None:
            live = self._watch.words(wanted=looks)
        if looks and result is None:
            hint = camera_hint(lamp_on=status is not None and status.lamp_on, views=len(session.views))
        return GuideView(CAMERA_GOAL, board, live=live, facts=self._watch.facts, result=result, hint=hint)

    def _take_scans(self) -> None:
        self._progress.sweeps.take(self._scans.entries)
        self.show_all(self.view)

    def _looks_for_board(self, view: RigView) -> bool:
        looks = self.is_current and not self._progress.plane_step
        return looks and view.connected and view.status is not None and not is_running(view.status)

    # ---- what can be done ----

    def why_not(self, action: str) -> str:
        """The step and the rig's state decide."""
        status = self.view.status
        situation = self._progress.situation(
            sweep_runs=is_running(status),
            simulated=status is not None and status.camera_kind == "simulated",
            working=self._job is not None,
        )
        return why_not(action, situation) or super().why_not(action)

    @property
    def _job(self) -> Job | None:
        """The running calibration."""
        return self.jobs.running_on(str(self._progress.session.folder))

    def default_target(self) -> int:
        """Where the sweep ends, the light is over the whole board; beyond, its edge no longer lies on a view."""
        assert self.view.status is not None
        return self.next_scan.last_steps if self._progress.plane_step else self.view.status.travel_steps[1]

    def action_expose(self) -> None:
        """Search the exposure once; for a sweep with the light over the whole board."""
        if not self._progress.plane_step:
            super().action_expose()
            return
        assert self.view.status is not None
        self._send_all(self._light.begin(self.next_scan.last_steps, self.view.status, self.shell.now_s()))

    def _send_all(self, commands: list[CommandCall]) -> None:
        def answered(answer: CommandAnswered) -> None:
            if not answer.ok:
                self._light.forget()
                self.say(f"{answer.name}: {answer.detail}", "error")

        for name, args in commands:
            self.send(name, answered, **args)

    def action_board(self) -> None:
        """Type what the board is."""
        board = self._progress.session.board
        fields = [
            FormField("squares", "squares", f"{board.columns}x{board.rows}", help="along both sides, or dots: 16x13"),
            FormField("square_mm", "size in mm", f"{board.square_mm:g}", help="side of a square, or pitch of the dots"),
            FormField("kind", "kind", board.kind, help="chessboard, charuco or dots"),
        ]
        self.ask(FormDialog("the board", fields, parse_board), self._save_board)

    def _save_board(self, board: BoardPattern) -> None:
        try:
            self._progress.session.save_board(board)
        except SweepscopeError as error:
            self.say(str(error), "error")
        self._watch_anew()

    def _watch_anew(self) -> None:
        """Start the search for the board again with its new arguments."""
        self._watch.begin_anew()
        self.show_all(self.view)

    def action_capture(self) -> None:
        """Save this view."""
        path = self._progress.session.next_view()

        def answered(answer: CommandAnswered) -> None:
            self.say(f"{path.name}: " + ("captured" if answer.ok else answer.detail), "info" if answer.ok else "error")

        self._progress.show_result = False
        self.send("capture", answered, path=str(path.absolute()))

    def action_undo(self) -> None:
        """Drop the last view."""
        try:
            self.say(f"{self._progress.session.drop_last_view()} was dropped")
        except SweepscopeError as error:
            self.say(str(error), "error")

    def action_anew(self) -> None:
        """Begin an empty session."""
        self._progress.begin_anew()
        self.say(f"a new calibration: {self._progress.session.folder}; the one before stays")
        self._watch_anew()

    def action_step(self) -> None:
        """Camera, light plane."""
        self._progress.next_step()
        self.show_all(self.view)

    def action_result(self) -> None:
        """Show the result, or the guidance."""
        self._progress.show_result = not self._progress.show_result
        self.show_all(self.view)

    def action_move(self, rows: int) -> None:
        """Choose another sweep."""
        self._list.move(rows)

    def action_use(self) -> None:
        """Use the chosen sweep, or not."""
        self._progress.sweeps.toggle(str(self._list.chosen))
        self.show_all(self.view)

    def action_sweep(self) -> None:
        """Sweep over the board as it lies."""
        name = f"board-{len(self._progress.sweeps.entries) + 1}"
        self.send("scan", name=name, **self.next_scan.plan_args(), purpose="calibration")

    def action_pose(self) -> None:
        """Place the simulated board in the next pose."""
        self.send("specimen", object="checkerboard", **self._progress.next_pose())

    def action_object(self) -> None:
        """Place the specimen back under the simulated camera."""
        self._progress.reset_poses()
        self.send("specimen", object="stirrup", tilt_x_deg=0.0, tilt_y_deg=0.0, moved_um=[0.0, 0.0, 0.0])

    def action_cancel(self) -> None:
        """Cancel the calibration."""
        self.jobs.cancel(self._job)

    def action_fit(self) -> None:
        """Calibrate with what was collected."""
        plane = self._progress.plane_step

        def ended(job: Job) -> None:
            if not job.cancelled:
                result = self._progress.take_job(job, plane=plane)
                self.say(result.headline, "info" if result.passed else "error")
            self.show_all(self.view)

        title, command = self._progress.fit(str(self._watch.facts.get("stage_view") or ""))
        self.jobs.start(title, command, str(self._progress.session.folder), ended)
