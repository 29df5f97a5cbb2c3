"""What holds for every test: nothing is left behind, and what the tests need is there, at least where it must be."""

from __future__ import annotations

import asyncio
import gc
import os
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
import pytest_timeout

from tests.needs import chromium_path, need
from tests.waiting import Stopwatch

GRACE_S = 5.0
"""What a test started may take so long to go away after the test's end."""

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    # begun in the background of a script: what tests start must hear Ctrl-C all the same
    signal.signal(signal.SIGINT, signal.default_int_handler)

_LASTING_THREADS = ("pymon", "asyncio_", "ThreadPoolExecutor", "numba", "playwright", "undisturbed-clock")


def _threads() -> set[threading.Thread]:
    alive = (thread for thread in threading.enumerate() if thread.is_alive())
    return {thread for thread in alive if not thread.name.startswith(_LASTING_THREADS)}


def _children() -> set[int]:
    return {child.pid for child in psutil.Process().children(recursive=True) if child.status() != psutil.STATUS_ZOMBIE}


def _sockets() -> set[str]:
    found = set()
    for link in Path("/proc/self/fd").iterdir():
        try:
            target = str(link.readlink())
        except OSError:
            continue
        if target.startswith("socket:"):
            found.add(target)
    return found


def _tasks() -> set[object]:
    try:
        loop = asyncio.get_running_loop()
    except RuntimeError:
        return set()
    return {task for task in asyncio.all_tasks(loop) if not task.done()}


_KINDS: dict[str, Callable[[], set]] = {
    "thread": _threads,
    "process": _children,
    "socket": _sockets,
    "task": _tasks,
}


def _left_behind(before: dict[str, set]) -> dict[str, set]:
    watch = Stopwatch()
    while True:
        left = {kind: count() - before[kind] for kind, count in _KINDS.items()}
        left = {kind: things for kind, things in left.items() if things}
        if not left or watch.elapsed_s > GRACE_S:
            return left
        gc.collect()
        threading.Event().wait(0.05)


@pytest.hookimpl
def pytest_timeout_set_timer(item: pytest.Item, settings: pytest_timeout.Settings) -> bool:
    """The time limit of a test counts seconds of an undisturbed machine, as all its waits do."""
    watch = Stopwatch()

    def rings(_signal: int, _frame: object) -> None:
        left_s = settings.timeout - watch.elapsed_s
        if left_s > 0:
            signal.setitimer(signal.ITIMER_REAL, max(left_s, 0.1))
        else:
            pytest_timeout.timeout_sigalrm(item, settings)

    def cancel() -> None:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)

    item.cancel_timeout = cancel  # type: ignore[attr-defined]  # the plugin calls it
    signal.signal(signal.SIGALRM, rings)
    signal.setitimer(signal.ITIMER_REAL, settings.timeout)
    return True


@pytest.fixture(autouse=True)
def nothing_is_left_behind(request: pytest.FixtureRequest) -> Iterator[None]:
    """Fail a test that leaves a thread, process, socket or task; module-wide fixtures may mark ``shares_processes``."""
    before = {kind: count() for kind, count in _KINDS.items()}
    yield
    if request.node.get_closest_marker("shares_processes"):
        return
    left = _left_behind(before)
    if left:
        pytest.fail(f"left behind: {left}")


@pytest.fixture
def run_dir() -> Iterator[Path]:
    """A socket directory with a path that is short enough, private, and gone afterwards."""
    import tempfile

    path = Path(tempfile.mkdtemp(prefix="ss-"))
    yield path
    shutil.rmtree(path, ignore_errors=True)


@pytest.fixture(autouse=True)
def clean_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """No stray configuration of the machine reaches a test."""
    for name in ("COLUMNS", "LINES"):
        monkeypatch.delenv(name, raising=False)
    for name in list(os.environ):
        if name.startswith("SWEEPSCOPE_") and name != "SWEEPSCOPE_TEST_DATA":
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/nonexistent")


@pytest.fixture(scope="session")
def real_scan() -> Path:
    """The public scan of a frog, which does not ship: in $SWEEPSCOPE_TEST_DATA, or shared/data beside the repository.

    A shorter sequence for the same tests is in tests/data.
    """
    root = Path(os.environ.get("SWEEPSCOPE_TEST_DATA") or Path(__file__).parents[2] / "shared" / "data")
    folder = root / "frog-v1-lr"
    if not folder.is_dir():
        pytest.skip(f"the real scan is not in {folder}: set SWEEPSCOPE_TEST_DATA")
    return folder


@pytest.fixture(scope="session")
def tmux() -> str:
    """The path of tmux."""
    need("tmux")
    return str(shutil.which("tmux"))


@pytest.fixture(scope="session")
def chromium() -> str:
    """The path of a Chromium browser."""
    need("chromium", "fonts-dejavu-core")
    return str(chromium_path())
