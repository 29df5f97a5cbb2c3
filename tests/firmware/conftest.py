"""The built firmware in its emulator, with the real driver on the real (pseudo) serial port."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from acquire.contract.config.model import StageConfig
from acquire.stages.protocol import Alarm, Moved, Segment, SegmentDone, StageEvent, Triggered
from acquire.stages.uno.config import switch_position_steps
from acquire.stages.uno.emulator import Emulator, PinState, TriggerEdge, build_firmware
from acquire.stages.uno.link import LinkTiming
from acquire.stages.uno.stage import UnoStage
from tests.needs import EMULATOR, need
from tests.waiting import DEADLINE_S, wait_for

WAIT_S = DEADLINE_S
LIMIT_AT = -300
"""Where the bench's switch is pressed, in true microsteps from the stage's place at the start."""


@pytest.fixture(scope="session")
def firmware(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """ELF and bench program, built once."""
    need(*EMULATOR)
    return build_firmware(tmp_path_factory.mktemp("firmware"))


class Bench:
    """An emulator, the driver on it, and what both said."""

    def __init__(self, firmware: tuple[Path, Path], *, pace: float = 0.0, homed: bool = True, **config: object):
        self.emulator = Emulator(*firmware, pace=pace, limit_at=LIMIT_AT)
        settings = {"acceleration_steps_per_s2": 100_000.0, "motion_lease_ms": 5000.0, **config}
        self.config = StageConfig(kind="uno", port=self.emulator.port, **settings)  # type: ignore[arg-type]
        self.events: queue.Queue[StageEvent] = queue.Queue()
        self.seen: list[StageEvent] = []
        self._edges: list[TriggerEdge] = []
        self.stage = UnoStage(self.config, timing=LinkTiming(silence_s=5.0))
        try:
            self.info = self.stage.open(self.events.put)
            self.emulator.watch(self._edges.append)
            if homed:
                self.stage.home()
                self.wait(Moved)
        except BaseException:
            self.close()
            raise

    @property
    def offset(self) -> int:
        """True position of the firmware's zero."""
        return LIMIT_AT - switch_position_steps(self.config)

    def pins(self) -> PinState:
        return self.emulator.state()

    @property
    def edges(self) -> list[TriggerEdge]:
        """Triggers that reached the camera: all that the pins have seen by now, however far behind their thread is."""
        delivered = self.pins().delivered
        self.until(lambda: len(self._edges) >= delivered)
        return self._edges

    def wait(self, kind: type, *, timeout_s: float = WAIT_S, alive: bool = True) -> StageEvent:
        """The next event of this kind; an alarm that nobody waits for fails."""
        return self.wait_until(lambda event: isinstance(event, kind), timeout_s=timeout_s, alive=alive)

    def wait_until(
        self, wanted: Callable[[StageEvent], bool], *, timeout_s: float = WAIT_S, alive: bool = True
    ) -> StageEvent:
        def came() -> StageEvent | None:
            if alive:
                self.stage.keep_alive()
            try:
                event = self.events.get(timeout=0.02)
            except queue.Empty:
                return None
            self.seen.append(event)
            if wanted(event):
                return event
            assert not isinstance(event, Alarm), event
            return None

        why = lambda: f"last were {self.seen[-5:]}; {self.stage.report}"  # noqa: E731
        found = wait_for(came, "the event", timeout_s, pause=lambda: None, why=why)
        assert found is not None
        return found

    def until(self, condition: Callable[[], bool], *, timeout_s: float = WAIT_S, alive: bool = True) -> None:
        """Wait for a state that no event tells."""

        def pause() -> None:
            if alive:
                self.stage.keep_alive()
            time.sleep(0.005)

        wait_for(condition, "the state", timeout_s, pause=pause, why=lambda: self.stage.report)

    def move(self, position_steps: int) -> Moved:
        self.stage.move_to(position_steps)
        moved = self.wait(Moved)
        assert isinstance(moved, Moved)
        return moved

    def sweep(self, segment: Segment, through: int | None = None) -> list[Triggered]:
        """Run a segment to its end; the events of its shots."""
        start = len(self.seen)
        self.stage.begin_segment(segment, segment.count - 1 if through is None else through)
        self.wait(SegmentDone)
        return [event for event in self.seen[start:] if isinstance(event, Triggered)]

    def assert_true_position(self) -> None:
        """The counted position is where the stage truly is."""
        self.until(lambda: self.pins().position - self.offset == self.stage.status().position_steps, timeout_s=5)

    def close(self) -> None:
        self.stage.close()
        self.emulator.close()


@pytest.fixture
def bench(firmware: tuple[Path, Path]) -> Iterator[Bench]:
    """A homed stage, as fast as the emulator goes."""
    found = Bench(firmware)
    yield found
    found.close()


@pytest.fixture
def make_bench(firmware: tuple[Path, Path]) -> Iterator[Callable[..., Bench]]:
    """Benches with other settings."""
    made: list[Bench] = []

    def make(**settings: object) -> Bench:
        made.append(Bench(firmware, **settings))  # type: ignore[arg-type]
        return made[-1]

    yield make
    for each in made:
        each.close()
