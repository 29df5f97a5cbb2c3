"""A console without a terminal that a test plays: any screen, with a connection and jobs that the test watches."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from pathlib import Path

from tests.fakes.fake_daemon import IDLE
from tests.fakes.fake_link import FakeLink
from tests.waiting import DEADLINE_S, Stopwatch
from tui.console.app import ConsoleApp
from tui.console.jobs import Job
from tui.console.link.messages import LinkChanged, StatusArrived, Updates
from tui.console.options import ConsoleOptions
from tui.console.screens.base import RigScreenBase

ME = "anna on pts/3"


class PlayedConsole:
    """A running console, what it sent, what it started, what it shows."""

    def __init__(self, app: ConsoleApp, pilot, link: FakeLink) -> None:
        self.app, self.pilot, self.link = app, pilot, link
        self.started: list[tuple[list[str], str]] = []
        self._calls: list[tuple] = []

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
        return "\n".join(line.text for line in self.app.state.log.lines)

    async def hear(self, *updates) -> None:
        self.app.post_message(Updates(list(updates), lambda: None))
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
        # private to Textual: nothing public renders what the terminal shows
        strips = self.app.screen._compositor.render_strips()
        return "\n".join("".join(segment.text for segment in strip) for strip in strips)

    def watch_jobs(self) -> None:
        """Jobs are noted instead of started."""

        def start(title, arguments, subject, on_end=None, *, on_result=None, quiet=False):
            job = Job(title, subject, quiet)
            self.started.append((list(arguments), subject))
            self._calls.append((job, on_end, on_result))
            return job

        self.app.jobs.start = start  # type: ignore[method-assign]

    async def end_job(self, result: dict | None, exit_status: int = 0, words: str = "") -> None:
        """The newest noted job ends."""
        job, on_end, _ = self._calls[-1]
        job.running, job.exit_status, job.result, job.words = False, exit_status, result, words
        on_end(job)
        await self.pilot.pause()

    async def report(self, result: dict) -> None:
        """The newest noted job prints an object."""
        self._calls[-1][2](result)
        await self.pilot.pause()


def play(
    script: Callable[[PlayedConsole], Awaitable[None]],
    *,
    screen: str = "scan",
    size: tuple[int, int] = (80, 24),
    data_dir: Path = Path("/nonexistent"),
    now_s: Callable[[], float] = time.monotonic,
    **options,
) -> None:
    """Run the console on ``screen`` and play ``script``."""

    async def run() -> None:
        links: list[FakeLink] = []

        def connect(post):
            links.append(FakeLink(post))
            return links[0]

        chosen = ConsoleOptions(me=ME, screen=screen, data_dir=data_dir, **options)
        app = ConsoleApp(connect, chosen, clock=lambda: "12:00:00", now_s=now_s)
        async with app.run_test(size=size) as pilot:
            await script(PlayedConsole(app, pilot, links[0]))

    asyncio.run(asyncio.wait_for(run(), 60))
