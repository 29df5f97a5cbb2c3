"""One calibration in its two steps, camera and light plane: session, sweeps, results; pure but for files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tui.console.calibration.calibration_sweeps import CalibrationSweeps
from tui.console.calibration.results import CalibrationResult, result_of
from tui.console.calibration.rules import PLANE_POSES, POSES, CalibrationSituation, Pose
from tui.console.calibration.session import CalibrationSession
from tui.console.jobs import Job


class CalibrationProgress:
    """The newest session of a folder of scans, and what has been done in it."""

    def __init__(self, data_dir: Path) -> None:
        self.session = CalibrationSession(data_dir)
        self.sweeps = CalibrationSweeps()
        self.plane_step = False
        """The second step, the light plane, is shown; else the camera."""
        self.show_result = False
        """Show the result of this step in place of the guidance."""
        self._results: dict[bool, CalibrationResult] = {}
        self._pose = 0

    @property
    def result(self) -> CalibrationResult | None:
        """The result that is to be shown."""
        return self._results.get(self.plane_step) if self.show_result else None

    def begin_anew(self) -> None:
        """An empty session; the one before stays on disk."""
        self.session.begin_anew()
        self._results, self.show_result = {}, False

    def next_step(self) -> None:
        """Camera, light plane."""
        self.plane_step = not self.plane_step
        self._pose = 0  # the simulated board begins flat again
        self.show_result = self.plane_step in self._results

    def next_pose(self) -> Pose:
        """Poses of the simulated board in turn."""
        poses = PLANE_POSES if self.plane_step else POSES
        self._pose += 1
        return poses[(self._pose - 1) % len(poses)]

    def reset_poses(self) -> None:
        """The next pose is the first one."""
        self._pose = 0

    def fit(self, stage_view: str) -> tuple[str, Sequence[str]]:
        """Title and arguments of the command that calibrates this step; ``stage_view``: the view that makes z = 0."""
        self.show_result = False
        if self.plane_step:
            return "calibrate the light plane", self.session.plane_command(self.sweeps.used)
        return "calibrate the camera", self.session.camera_command(stage_view)

    def take_job(self, job: Job, *, plane: bool) -> CalibrationResult:
        """A calibration has ended."""
        before = self.session.document_before().get("camera") or {}
        self._results[plane] = result = result_of(job, before, plane=plane)
        self.show_result = True
        return result

    def situation(self, *, sweep_runs: bool, simulated: bool, working: bool) -> CalibrationSituation:
        """Everything that decides what can be done now."""
        return CalibrationSituation(
            plane_step=self.plane_step,
            sweep_runs=sweep_runs,
            simulated=simulated,
            views=len(self.session.views),
            sweeps=len(self.sweeps.entries),
            used=len(self.sweeps.used),
            has_camera=self.session.result.is_file(),
            has_result=self.plane_step in self._results,
            working=working,
        )
