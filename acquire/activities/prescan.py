"""Pre-scan: one picture at every n-th position of a sweep, from which bounds and exposure are proposed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, Final

from acquire.cameras.protocol import CameraFrame
from acquire.contract.errors import CommandRefusedError
from acquire.contract.messaging.messages import Proposal
from acquire.rigs.base import Rig
from acquire.stages.protocol import Moved

from .base import Activity, Rest
from .images import measure, reduce
from .prescan_analysis import PrescanPictures

MAX_PICTURES: Final = 200
"""Bound of the pictures, which are kept in memory until the last one."""
FRAMES_PER_PICTURE: Final = 20


def prescan_positions(first_steps: int, last_steps: int, every_steps: int | None, steps_per_frame: int) -> list[int]:
    """Positions of the pictures, both ends included; without ``every_steps`` twenty frames apart, or more if need be.

    Raises:
        CommandRefusedError: too many pictures.
    """
    distance = abs(last_steps - first_steps)
    least = -(-distance // (MAX_PICTURES - 1))
    every = every_steps or max(FRAMES_PER_PICTURE * steps_per_frame, least)
    if every < least:
        raise CommandRefusedError(f"a pre-scan takes up to {MAX_PICTURES} pictures: use every_steps of {least} or more")
    step = every if last_steps >= first_steps else -every
    positions = list(range(first_steps, last_steps, step))
    return [*positions, last_steps]


class Prescan(Activity):
    """Moves, settles and takes a picture, at one position after the other, with the lamp on."""

    name: ClassVar[str] = "prescan"
    moves: ClassVar[bool] = True
    snaps: ClassVar[bool] = True

    def __init__(
        self,
        rig: Rig,
        positions: Sequence[int],
        snap: Callable[[int], None],
        *,
        settle_ns: int,
        warm_up_ns: int,
        conclude: Callable[[PrescanPictures], tuple[Proposal, int]],
        keep: Callable[[Proposal], None],
    ) -> None:
        """``conclude`` makes the proposal for ``keep`` from all pictures, and finds the position where most is lit."""
        super().__init__()
        self._positions = positions
        self._stage, self._snap, self._format = rig.stage, snap, rig.camera_info.format
        self._settle_ns, self._warm_up_ns = settle_ns, warm_up_ns
        self._conclude, self._keep = conclude, keep
        self._taken = PrescanPictures()
        self._warm_ns: int | None = None
        self._snap_ns: int | None = None

    def begin(self, now_ns: int) -> None:
        """Go to the first position while the lamp warms up."""
        self._warm_ns = now_ns + self._warm_up_ns
        self._stage.move_to(self._positions[0])

    def on_rest(self, event: Rest, now_ns: int) -> None:
        """The stage has arrived: let it settle."""
        here = self._positions[len(self._taken.positions)]
        if not isinstance(event, Moved) or event.position_steps != here:
            self.end(f"the stage stopped at {event.position_steps} microsteps", failed=True)
        else:
            self._snap_ns = max(now_ns + self._settle_ns, self._warm_ns or 0)

    def on_tick(self, now_ns: int) -> None:
        """Take the picture once the stage has settled and the lamp is warm."""
        if self._snap_ns is not None and now_ns >= self._snap_ns:
            self._snap_ns = None
            self._snap(now_ns)

    def on_frame(self, frame: CameraFrame, now_ns: int) -> None:
        """Keep the picture and go to the next position, or conclude."""
        brightness = measure(frame.pixels, self._format.bit_depth)
        here = self._positions[len(self._taken.positions)]
        small = reduce(frame.pixels, self._format)
        self._taken.add(here, small, brightness.high / 255, brightness.full_scale_share)
        done = len(self._taken.positions)
        self.share = done / len(self._positions)
        if done < len(self._positions):
            self._stage.move_to(self._positions[done])
            return
        proposal, brightest = self._conclude(self._taken)
        self._keep(proposal)
        warned = f"; {proposal.warnings[0]}" if proposal.warnings else ""
        self.end(
            f"proposes {proposal.first_steps} to {proposal.last_steps}, {proposal.frames} frames, "
            f"{proposal.exposure_ms:.3g} ms; most of the specimen is lit at {brightest}{warned}"
        )

    def on_no_frame(self, now_ns: int) -> None:
        """Propose nothing from half of the pictures."""
        done, count = len(self._taken.positions), len(self._positions)
        self.end(f"no usable picture came at position {done + 1} of {count}: is the camera connected?", failed=True)
