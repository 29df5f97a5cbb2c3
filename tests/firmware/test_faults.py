"""What goes wrong between host and stage: noise, cables, resets, other firmware, late hosts, lost edges, switches."""

from __future__ import annotations

import os

import pytest

from acquire.contract.config.model import StageConfig
from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Alarm, Held, Moved, Segment, SegmentDone, Stopped, Triggered
from acquire.stages.uno.emulator import Emulator, build_firmware
from acquire.stages.uno.handshake import FirmwareMismatchError
from acquire.stages.uno.link import LinkTiming
from acquire.stages.uno.ports import PortError, open_port
from acquire.stages.uno.serial_io import LinkLostError
from acquire.stages.uno.stage import UnoStage
from acquire.stages.uno.wire_format import LINK_BAUD, Cmd, McuState, MoveBody, StatusBody
from tests.waiting import WALL_CLOCK_S

STEP = Segment(30, 3, 12, mode="step", settle_ms=0.5, dwell_ms=1.0, run_up_steps=20)
FLY = Segment(30, 3, 40, mode="fly", period_ms=1000 / 60, run_up_steps=20)

LONG_STEP = Segment(30, 3, 60, mode="step", settle_ms=0.5, dwell_ms=1.0, run_up_steps=20)
LONG_FLY = Segment(30, 3, 80, mode="fly", period_ms=1000 / 60, run_up_steps=20)


def true_positions(bench, first=0):
    return [edge.position_steps - bench.offset for edge in bench.edges[first:]]


def wanted(segment):
    return [segment.first_steps + j * segment.pitch_steps for j in range(segment.count)]


def at_rest(bench):
    """By a fresh report: the last one may be older than the last command."""
    bench.stage.send(Cmd.STATUS, StatusBody(0).pack()).result(timeout=3)
    return bench.stage.report.state == McuState.IDLE


def shot(index):
    return lambda event: isinstance(event, Triggered) and event.shot_index >= index


# ---- F01 the host dies ----


def test_f01_a_new_host_finds_the_stage_at_rest_and_its_position_still_trusted(make_bench):
    bench = make_bench(motion_lease_ms=300.0, pace=1.0)
    zero_id = bench.stage.status().zero_id
    bench.stage.begin_segment(LONG_FLY, LONG_FLY.count - 1)
    bench.wait_until(shot(5))
    bench.stage._link.close()  # no stop, no word: as a killed process leaves it
    successor = UnoStage(bench.config)
    try:
        successor.open(bench.events.put)
        found = successor.status()
        assert found.position_trusted and found.zero_id == zero_id
        pins = bench.pins()
        assert pins.position - bench.offset == found.position_steps and pins.triggers < LONG_FLY.count
        assert found.triggers == pins.triggers
        successor.begin_segment(Segment(30, 3, 2, run_up_steps=20), 1)
        bench.stage = successor
        bench.wait(SegmentDone)
    finally:
        successor.close()
    assert true_positions(bench)[-2:] == [30, 33]


# ---- F11 noise ----


@pytest.mark.parametrize("seed", [1, 2])
def test_f11_noise_on_the_line_moves_nothing_wrong_and_runs_nothing_twice(bench, seed):
    bench.emulator.knob(f"seed {seed}")
    bench.move(50)
    bench.emulator.knob("noise 0.01")
    place = 50
    before = bench.pins()
    asked = moved = 0
    while bench.pins().bytes_in - before.bytes_in < 15_000:
        distance = 1 if place < 100 else -1
        answers = [bench.stage.send(Cmd.MOVE, MoveBody(distance, 1, 0).pack()) for _ in range(8)]
        bench.stage.keep_alive()
        # a relative move is refused while the one before still runs: what was acknowledged, and only that, moves
        done = [answer.result(timeout=WALL_CLOCK_S).body[0] == 0 for answer in answers]
        asked, moved = asked + len(done), moved + sum(done)
        place += distance * sum(done)
    bench.emulator.knob("noise 0")
    bench.until(lambda: at_rest(bench))
    assert bench.pins().hurt > 100 and bench.stage.counters()["damaged"] > 30
    assert bench.pins().steps - before.steps == moved > 100
    bench.assert_true_position()
    assert bench.stage.status().position_steps == place


def test_f11_a_sweep_under_noise_is_complete_and_exact(bench):
    bench.emulator.knob("noise 0.002")
    bench.stage.begin_segment(FLY, 0)
    for through in range(1, FLY.count, 3):
        bench.stage.grant(through)
    bench.stage.grant(FLY.count - 1)
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(FLY)
    shots = [event.position_steps for event in bench.seen if isinstance(event, Triggered)]
    assert shots == wanted(FLY)


# ---- F12 the cable ----


def test_f12_a_pulled_cable_holds_and_the_sweep_goes_on_when_it_is_back(make_bench):
    bench = make_bench(motion_lease_ms=300.0, pace=1.0)
    bench.stage.begin_segment(LONG_FLY, LONG_FLY.count - 1)
    bench.wait_until(shot(5))
    bench.emulator.knob("unplug")
    bench.until(lambda: not bench.stage.status().position_trusted)
    with pytest.raises(CommandRefusedError, match="moving"):
        bench.stage.move_to(0)
    bench.emulator.knob("plug")
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(LONG_FLY)
    assert bench.stage.status().position_trusted


def test_f12_a_cable_that_stays_out_ends_the_activity_with_a_named_alarm(bench, monkeypatch):
    monkeypatch.setattr("acquire.stages.uno.reports._RECONNECT_S", 0.2)
    bench.stage.begin_segment(STEP, 2)
    bench.wait_until(shot(2))
    bench.emulator.knob("unplug")
    alarm = bench.wait(Alarm)
    assert alarm.code == "F12" and not alarm.position_trusted
    with pytest.raises(CommandRefusedError, match="plug it in"):
        bench.stage.move_to(0)


# ---- F13 the controller restarts ----


@pytest.mark.parametrize(
    ("cause", "words"), [("external", "reset line"), ("brownout", "voltage"), ("watchdog", "watchdog")]
)
def test_f13_a_restart_is_named_and_the_position_is_not_trusted(bench, cause, words):
    bench.stage.set_lamp(on=True)
    bench.stage.begin_segment(STEP, 3)
    bench.wait_until(shot(2))
    bench.emulator.knob(f"reset {cause}")
    alarm = bench.wait(Alarm)
    assert alarm.code == "F13" and words in alarm.detail and not alarm.position_trusted
    pins = bench.pins()
    assert (pins.lamp, pins.step_pin, pins.trigger_pin) == (0, 0, 0)
    with pytest.raises(CommandRefusedError, match="home"):
        bench.stage.begin_segment(STEP, 0)
    bench.stage.home()
    bench.wait(Moved)
    first = len(bench.edges)
    bench.sweep(STEP)
    assert true_positions(bench, first) == wanted(STEP)


def test_f13_a_program_that_hangs_is_restarted_by_the_watchdog(bench):
    bench.stage.begin_segment(STEP, 3)
    bench.wait_until(shot(1))
    bench.emulator.knob("hang")
    alarm = bench.wait(Alarm)
    assert alarm.code == "F13" and "watchdog" in alarm.detail


# ---- F14 other firmware ----


@pytest.mark.parametrize(
    ("argument", "words"), [("DEFINES=-DPROTOCOL_MAJOR=9", r"9\.0.*1\.0"), ("WIRE_CRC=0x12345678UL", "12345678")]
)
def test_f14_another_firmware_is_refused_and_both_are_named(tmp_path, argument, words):
    elf, program = build_firmware(tmp_path, argument)
    with Emulator(elf, program, pace=0) as emulator:
        stage = UnoStage(StageConfig(kind="uno", port=emulator.port))
        with pytest.raises(FirmwareMismatchError, match=words):
            stage.open(lambda _event: None)
        assert emulator.state().steps == 0


def test_f14_a_port_where_nothing_answers_says_so(firmware):
    master, slave = os.openpty()
    try:
        stage = UnoStage(StageConfig(kind="uno", port=os.ttyname(slave)), timing=LinkTiming(hello_s=0.3))
        with pytest.raises(LinkLostError, match="powered"):
            stage.open(lambda _event: None)
    finally:
        os.close(master)
        os.close(slave)


def test_a_port_that_is_missing_or_busy_is_said_in_plain_words(bench):
    with pytest.raises(PortError, match="no serial port /dev/ttyNOT"):
        open_port("/dev/ttyNOT", LINK_BAUD)
    with pytest.raises(PortError, match="busy"):
        open_port(bench.emulator.port, LINK_BAUD)
    with pytest.raises(PortError, match="serial port"):
        open_port("/dev/null", LINK_BAUD)


# ---- F15 the host is late ----


@pytest.mark.parametrize("segment", [LONG_STEP, LONG_FLY], ids=["step", "fly"])
def test_f15_a_host_that_falls_silent_finds_the_stage_holding_and_goes_on(make_bench, segment):
    bench = make_bench(motion_lease_ms=300.0, pace=1.0)
    bench.stage.begin_segment(segment, segment.count - 1)
    held = bench.wait(Held, alive=False)
    assert held.reason == "lease"
    bench.assert_true_position()
    fired = bench.pins().triggers
    assert fired < segment.count
    bench.wait(SegmentDone)
    assert true_positions(bench) == wanted(segment)


def test_f15_a_move_without_a_living_host_ends_at_a_known_place(make_bench):
    bench = make_bench(motion_lease_ms=300.0, pace=1.0)
    bench.stage.move_to(4500)
    stopped = bench.wait(Stopped, alive=False)
    assert stopped.reason == "lease" and stopped.position_trusted and stopped.position_steps < 4500
    bench.assert_true_position()


# ---- F16 a lost edge ----


def test_f16_a_trigger_edge_that_is_lost_on_the_way_is_missing_among_the_strobes(bench):
    bench.emulator.knob("drop 5")
    shots = bench.sweep(STEP)
    bench.until(lambda: bench.stage.counters()["strobes"] == STEP.count - 1)
    assert len(shots) == STEP.count and len(bench.edges) == STEP.count - 1
    (again,) = bench.sweep(Segment(wanted(STEP)[4], 3, 1, run_up_steps=20))
    assert true_positions(bench)[-1] == again.position_steps == wanted(STEP)[4]


# ---- F23 switches ----


def test_f23_the_emergency_stop_stops_by_itself_and_is_sticky(bench):
    bench.stage.set_lamp(on=True)
    bench.stage.move_to(4500)
    bench.until(lambda: bench.pins().position - bench.offset > 300)
    bench.emulator.knob("estop 1")
    alarm = bench.wait(Alarm)
    assert alarm.code == "F23" and "emergency" in alarm.detail and not alarm.position_trusted
    steps = bench.pins().steps
    assert (bench.pins().driver, bench.pins().lamp) == (0, 0)
    with pytest.raises(CommandRefusedError, match="release"):
        bench.stage.move_to(0)
    bench.emulator.knob("estop 0")
    bench.until(lambda: not bench.stage.report.flags & 32)
    assert bench.pins().steps == steps
    bench.stage.home()
    assert bench.wait(Moved).position_trusted
    bench.assert_true_position()


def test_f23_the_emergency_byte_stops_at_once(bench):
    bench.stage.move_to(4500)
    bench.until(lambda: bench.pins().position - bench.offset > 300)
    bench.stage.emergency_stop()
    assert "emergency" in bench.wait(Alarm).detail
    assert bench.pins().driver == 0


def test_f23_the_limit_switch_ends_a_sweep_with_an_alarm(bench):
    bench.move(300)
    bench.stage.begin_segment(Segment(240, -3, 60, mode="fly", period_ms=20, run_up_steps=20), 59)
    bench.wait_until(shot(5))
    bench.emulator.knob("limit press")
    alarm = bench.wait(Alarm)
    assert alarm.code == "F23" and "limit" in alarm.detail and not alarm.position_trusted
    fired = bench.pins().triggers
    bench.emulator.knob("limit auto")
    bench.stage.home()
    bench.wait(Moved)
    assert bench.pins().triggers == fired
