"""Carries out the actions of one sweep on the devices, which nothing else uses meanwhile."""

from __future__ import annotations

import logging
import shutil
import threading
from collections.abc import Callable
from typing import Any

import cv2
from numpy.typing import NDArray

from acquire.activities.images import PreviewFrame
from acquire.cameras.protocol import CameraGone, CameraLostError
from acquire.contract.errors import SweepscopeError
from acquire.contract.messaging.lanes import Sender, shared
from acquire.contract.messaging.messages import FaultReport, Image
from acquire.contract.scan_data.dataset_names import MARKS_NAME, NO_SCAN_NAMES
from acquire.contract.scan_data.reader import write_marks
from acquire.rigs.base import Rig
from acquire.stages.protocol import Alarm
from acquire.sweep import actions as do
from acquire.sweep.events import SweepEvent
from acquire.sweep.phases import Phase
from acquire.sweep.state_machine import Sweep

from .frame_sender import FrameSender
from .scan_setup import PreparedScan

logger = logging.getLogger(__name__)


class RunningScan:
    """A sweep with its stage, camera and lanes. One thread calls everything."""

    def __init__(
        self,
        prepared: PreparedScan,
        rig: Rig,
        lane: FrameSender,
        live: Sender,
        *,
        on_fault: Callable[[FaultReport], None],
        on_message: Callable[[str], None],
        on_view: Callable[[PreviewFrame], None],
    ) -> None:
        self.prepared = prepared
        self._rig, self._lane, self._live = rig, lane, live
        self._on_fault, self._on_message, self._on_view = on_fault, on_message, on_view
        self.live_drops = 0
        self._truth: threading.Thread | None = None
        lane.begin(prepared.start)
        self.sweep = Sweep(prepared.settings, prepared.slots)
        live.send(prepared.start)

    def begin(self, now_ns: int) -> None:
        """Announce the scan; nothing moves until the writer is ready."""
        self.sweep.position_steps = self._rig.stage.status().position_steps
        self.sweep.start(now_ns)
        self._truth = self._rig.write_truth(self.prepared.folder, self.prepared.start.plan)

    def handle(self, event: SweepEvent, now_ns: int) -> None:
        """Hand an event to the sweep, and carry out its actions.

        A stage that refuses an action ends the sweep; a camera that does is waited for.
        """
        try:
            self._carry_out(self.sweep.handle(event, now_ns))
        except CameraLostError as error:
            for action in self.sweep.handle(CameraGone(str(error)), now_ns):
                self._try(action)
        except SweepscopeError as error:
            logger.error("a device refused: %s", error)
            # also where the camera refused: the stage may have received a command that it did not answer
            self._try(do.StopStage())
            position = self._rig.stage.status().position_steps
            alarm = Alarm("F12", str(error), position, position_trusted=False)
            for action in self.sweep.handle(alarm, now_ns):
                self._try(action)

    def _try(self, action: do.Action) -> None:
        """Carry out one action of an ending; the next one is tried even if this one fails."""
        try:
            self._do(action)
        except SweepscopeError as error:
            logger.error("%s failed: %s", type(action).__name__, error)

    @property
    def done(self) -> bool:
        """The scan is over and its outcome known."""
        return self.sweep.phase is Phase.DONE

    def close(self) -> None:
        """Release the scan and its lock."""
        self._lane.forget()
        if self._truth is not None:
            self._truth.join(timeout=60)
        self._remove_if_empty()
        self.prepared.lock.release()

    def _remove_if_empty(self) -> None:
        """Remove the folder if no scan file was ever made in it."""
        folder = self.prepared.folder
        try:
            left = {path.name for path in folder.iterdir()} - NO_SCAN_NAMES
        except OSError as error:
            logger.warning("the folder of the scan cannot be read any more: %s", error)
            return
        if not left and self.sweep.end_ack is None:
            shutil.rmtree(folder, ignore_errors=True)

    def _carry_out(self, actions: list[do.Action]) -> None:
        """Frames are published even if a device refuses an action before them: the sweep waits for their acks."""
        for index, action in enumerate(actions):
            try:
                self._do(action)
            except SweepscopeError:
                for later in actions[index + 1 :]:
                    if isinstance(later, do.Publish):
                        self._do(later)
                raise

    def _do(self, action: do.Action) -> None:  # noqa: C901, PLR0912 - one line for each action, nothing else
        stage, camera = self._rig.stage, self._rig.camera
        match action:
            case do.Publish(image, pixels):
                self._publish(image, pixels)
            case do.Grant(through):
                stage.grant(through)
            case do.BeginSegment(segment, through):
                stage.begin_segment(segment, through)
            case do.Arm():
                camera.arm()
            case do.Disarm():
                camera.disarm()
            case do.Snap():
                camera.snap()
            case do.SetLamp(on):
                self._rig.set_lamp(on=on)
            case do.HoldStage():
                stage.hold()
            case do.ResumeStage():
                stage.resume()
            case do.StopStage():
                stage.stop()
            case do.CheckLimit():
                stage.check_limit()
            case do.SavePicture(name, picture):
                self._save(name, picture)
            case do.SaveMarks(measured):
                self._mark(measured)
            case do.SendEnd(end):
                self._lane.finish(end)
                self._live.send(end)
            case do.RaiseFault(fault):
                self._on_fault(fault)
            case do.Say(text):
                self._on_message(text)

    def _save(self, name: str, picture: NDArray[Any]) -> None:
        """Write a picture (RGB) beside the scan; the sweep does not depend on it."""
        # by its bytes: OpenCV dies of a path that is no UTF-8
        encoded = cv2.imencode(".png", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))[1]
        try:
            (self.prepared.folder / name).write_bytes(encoded.tobytes())
        except OSError as error:
            self._on_message(f"cannot write {name} beside the scan: {error.strerror}")

    def _mark(self, measured: dict[str, float]) -> None:
        folder = self.prepared.folder
        try:
            write_marks(folder, measured)
        except OSError as error:
            text = "cannot write %s: %s; the measurements will be in the end of the scan only"
            logger.error(text, folder / MARKS_NAME, error)  # noqa: TRY400

    def _publish(self, image: Image, pixels: NDArray[Any]) -> None:
        """The lossless lane first; the live lane may drop, and counts it."""
        part = shared(pixels)
        self._lane.offer(image, part)
        if not self._live.send(image, part):
            self.live_drops += 1
        if image.role == "sweep":
            start = self.prepared.start
            place = image.position_steps, image.position_um
            self._on_view(PreviewFrame(pixels, *place, start.plan.exposure_ms, image.frame_index, start.scan_uid))
