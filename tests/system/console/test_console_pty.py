"""The console on a terminal that is slow, stuck, or gone."""

from __future__ import annotations

from acquire.contract.states import State
from tests.fakes.fake_daemon import IDLE, FakeDaemon
from tests.fakes.processes.pty_console import PtyConsole
from tests.waiting import Stopwatch, exit_status


def test_stop_reaches_the_daemon_while_the_terminal_takes_nothing(run_dir):
    with FakeDaemon(run_dir, frames_per_tick=1, expected=100_000) as daemon, PtyConsole(run_dir) as console:
        console.wait_for("IDLE")
        daemon.show_pictures = True
        console.wait_for("px")
        console.stick(b"][" * 100)
        console.type(b" ")
        daemon.asked("stop", deadline_s=5.0)
        assert console.stalled.is_set()


def test_stop_reaches_the_daemon_from_a_stuck_terminal_also_behind_letters_and_from_a_text_field(run_dir):
    for keys in (b"f ", b"i\x18"):
        with FakeDaemon(run_dir, frames_per_tick=1, expected=100_000) as daemon, PtyConsole(run_dir) as console:
            console.wait_for("IDLE")
            daemon.show_pictures = True
            console.wait_for("px")
            console.stick(b"][" * 100)
            console.type(keys)
            daemon.asked("stop", deadline_s=5.0)


def test_a_text_that_is_typed_ahead_of_its_dialog_does_not_stop_the_sweep(run_dir):
    with FakeDaemon(run_dir, IDLE) as daemon, PtyConsole(run_dir) as console:
        console.wait_for("IDLE")
        daemon.show(state=State.SWEEPING, expected=100_000)
        console.wait_for("SWEEPING")
        console.type(b"iswollen at the base")  # letters before the dialog has its field are lost
        console.wait_for("CTRL+X = STOP")
        console.type(b"\tdry and brittle\r")
        console.wait_for("dry and brittle")
        assert "stop" not in [name for name, _ in daemon.commands]


def test_on_a_link_of_100_kB_per_s_keys_are_echoed_and_the_picture_gives_way(run_dir):
    with (
        FakeDaemon(run_dir) as daemon,
        PtyConsole(run_dir, rate_bytes_per_s=100_000, size=(160, 50)) as console,
    ):
        console.wait_for("IDLE")
        daemon.show_pictures = True
        console.wait_for("coarser")
        echoes = [_echo_s(console, key, words) for key, words in ((b"]", "100"), (b"]", "300"), (b"[", "100"))]
        assert sorted(echoes)[1] < 3.0  # seconds of stale pictures would be far above; the figure is in the bench


def _echo_s(console: PtyConsole, key: bytes, words: str) -> float:
    console.forget()
    watch = Stopwatch()
    console.type(key)
    console.wait_for(words)
    return watch.elapsed_s


def test_a_terminal_that_is_gone_ends_the_console_and_not_the_sweep(run_dir):
    sweeping = {"state": State.SWEEPING, "expected": 100_000}
    with FakeDaemon(run_dir, IDLE) as daemon, PtyConsole(run_dir) as console:
        console.wait_for("IDLE")
        daemon.show_pictures = True
        daemon.show(**sweeping)
        console.wait_for("SWEEPING")
        console.hang_up()
        console.process.send_signal(1)
        exit_status(console.process)
        assert daemon.status.state == State.SWEEPING and "stop" not in [name for name, _ in daemon.commands]
