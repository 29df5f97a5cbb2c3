"""The daemon's way out: every step is tried, whichever of them fails."""

from __future__ import annotations

import pytest

from acquire.cameras.protocol import CameraInfo, CameraSettings
from acquire.contract.config.load import load_config
from acquire.contract.messaging.messages import FrameFormat
from acquire.daemon.service import Daemon
from acquire.rigs.base import Rig
from acquire.stages.protocol import StageInfo, StageStatus

STEPS = ("stage.stop", "camera.disarm", "stage.close", "camera.close")


class Device:
    """Notes what is asked of it; one step may fail."""

    def __init__(self, name: str, calls: list[str], failing: str) -> None:
        self._name, self._calls, self._failing = name, calls, failing

    def open(self, _sink):
        small = FrameFormat(width=16, height=16, bit_depth=8)
        return StageInfo(kind="x") if self._name == "stage" else CameraInfo(kind="x", format=small)

    def configure(self, settings: CameraSettings) -> CameraSettings:
        return settings

    def status(self) -> StageStatus:
        return StageStatus(0, True, "z", False, 0, False)

    def __getattr__(self, step: str):
        def call() -> None:
            self._calls.append(f"{self._name}.{step}")
            if self._calls[-1] == self._failing:
                raise OSError(f"{step} fails")

        return call


@pytest.mark.parametrize("failing", ["", *STEPS])
def test_each_step_of_the_cleanup_is_tried_even_if_another_fails(run_dir, failing, caplog):
    calls: list[str] = []
    daemon = Daemon(
        load_config(environ={}), run_dir, Rig(Device("stage", calls, failing), Device("camera", calls, failing))
    )
    daemon.open()
    daemon.close()
    assert [call for call in calls if call in STEPS] == list(STEPS)
    assert ("a step of the cleanup failed" in caplog.text) == bool(failing)
