"""A console without a terminal that a test plays: any screen, with a connection and jobs that the test watches."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path

from tests.fakes.fake_daemon import IDLE
from tests.fakes.fake_link import FakeLink
from tests.waiting import DEADLINE_S, Stopwatch
from tui.console.app import ConsoleApp, ConsoleOptions
from tui.console.link.messages import LinkChanged, StatusArrived
from tui.console.screens.base import RigScreenBase
from tui.processes.child_jobs import Job

ME = "anna on pts/3"


class Stage:
    """A running console, what it sent, what it started, what it shows."""

    def __init__(self, app: ConsoleApp, pilot) -> None:
        self.app, self.pilot = app, pilot
        self.link: FakeLink = app._link  # type: ignore[assignment]
        self.started: list[tuple[list[str], str]] = []
        self._ends: list = []

    @property
    def screen(self) -> RigScreenBase:
        assert self.app.rig_screen is not None
        return self.app.rig_screen

    @property
    def sent(self) -> list[tuple[str, dict]]:
        """Commands, but for the questions that the scan screen asks by itself."""
        return [(name, args) for name, args in self.link.sent if name != "estimate"]

    @property
    def log(self) -> str:
        return "\n".join(line.text for line in self.app.logbook.lines)

    async def hear(self, *messages) -> None:
        for message in messages:
            self.app.post_message(message)
        await self.pilot.pause()

    async def connect(self, status=IDLE) -> None:
        await self.hear(LinkChanged(True, "/run/x"), StatusArrived(status))

    async def press(self, *keys: str) -> None:
        await self.pilot.press(*keys)
        await self.pilot.pause()

    async def type(self, text: str) -> None:
        await self.press(*("slash" if sign == "/" else "full_stop" if sign == "." else sign for sign in text))

    async def until(self, condition: Callable[[], object], what: str) -> None:
        """Wait until the condition holds; the console goes on meanwhile."""
        watch = Stopwatch()
        while not condition():
            assert watch.elapsed_s < DEADLINE_S, f"never: {what}\n{self.log}\n{self.painted}"
            await self.pilot.pause(0.02)

    def shown(self, pane) -> str:
        return self.screen.query_one(pane).plain

    @property
    def painted(self) -> str:
        """The whole screen as text."""
        return "\n".join("".join(segment.text for segment in strip) for strip in self._strips())

    def _strips(self):
        return self.app.screen._compositor.render_strips()

    def watch_jobs(self) -> None:
        """Jobs are noted instead of started."""

        def start(title, arguments, subject, on_end=None, **_):
            self.started.append((list(arguments), subject))
            self._ends.append(on_end)
            return Job(len(self.started), title, subject, 0.0)

        self.app.jobs.start = start  # type: ignore[method-assign]

    async def end_job(self, result: dict | None, exit_status: int = 0, **facts) -> None:
        """The newest noted job ends."""
        self._ends[-1](Job(1, "job", "", 0.0, running=False, exit_status=exit_status, result=result, **facts))
        await self.pilot.pause()


def play(
    script: Callable[[Stage], Awaitable[None]],
    *,
    screen: str,
    size: tuple[int, int] = (80, 24),
    ascii_only: bool = False,
    read_only: bool = False,
    data_dir: Path = Path("/nonexistent"),
) -> None:
    """Run the console on ``screen`` and play ``script``."""

    async def run() -> None:
        options = ConsoleOptions(me=ME, screen=screen, ascii_only=ascii_only, read_only=read_only, data_dir=data_dir)
        app = ConsoleApp(FakeLink, options, clock=lambda: "12:00:00")
        async with app.run_test(size=size) as pilot:
            await script(Stage(app, pilot))

    asyncio.run(run())
