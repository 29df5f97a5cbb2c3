"""Moves, homing and switches: the counted position is the true one at the pins."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.stages.protocol import Alarm, Moved, Segment, SegmentDone, Stopped
from acquire.stages.uno.config import switch_position_steps
from acquire.stages.uno.emulator import FIRMWARE_DIR
from tests.firmware.conftest import LIMIT_AT
from tests.needs import need
from tests.waiting import run


def make(build_dir, target):
    command = ["make", "-s", "-C", str(FIRMWARE_DIR), f"BUILD={build_dir}", target]
    return run(command)


def test_the_pure_parts_hold_when_compiled_for_this_machine(tmp_path):
    need("gcc", "libc6-dev")
    done = make(tmp_path, "test")
    assert done.returncode == 0, done.stdout + done.stderr


def test_flash_and_ram_leave_the_room_that_the_stack_needs(firmware):
    done = make(firmware[0].parent, "size")
    assert done.returncode == 0, done.stdout + done.stderr


def test_homing_puts_the_switch_where_the_configuration_says(make_bench):
    bench = make_bench(homed=False)
    assert not bench.stage.status().position_trusted
    bench.stage.home()
    moved = bench.wait(Moved)
    assert moved.position_trusted and moved.zero_id
    assert moved.position_steps == switch_position_steps(bench.config) + 50
    bench.assert_true_position()


def test_homing_is_exact_with_a_bouncing_switch(make_bench):
    bench = make_bench(homed=False)
    bench.emulator.knob("bounce_ms 3")
    bench.stage.home()
    bench.wait(Moved)
    bench.assert_true_position()


def test_homing_works_from_on_the_switch(bench):
    bench.emulator.knob("limit_at -200")
    bench.stage.home()
    moved = bench.wait(Moved)
    assert bench.pins().position == -200 + moved.position_steps - switch_position_steps(bench.config)


def test_each_homing_and_zeroing_makes_a_new_zero(bench):
    first = bench.stage.status().zero_id
    bench.stage.home()
    second = bench.wait(Moved).zero_id
    bench.stage.zero_here()
    third = bench.wait(Moved)
    assert len({first, second, third.zero_id}) == 3
    assert third.position_steps == 0 and third.position_trusted


def test_a_switch_that_is_not_there_ends_homing_with_an_alarm(make_bench):
    bench = make_bench(homed=False, travel_max_steps=300)
    bench.emulator.knob("limit_at -1000000")
    bench.stage.home()
    alarm = bench.wait(Alarm)
    assert alarm.code == "F23" and "not found" in alarm.detail and not alarm.position_trusted


def test_touching_the_limit_again_finds_lost_steps(bench):
    bench.move(500)
    bench.stage.check_limit()
    assert bench.wait(Moved).steps_lost == 0
    bench.move(500)
    bench.emulator.knob("slip -7")  # the stage is 7 microsteps nearer to the switch than it counts
    bench.stage.check_limit()
    assert bench.wait(Moved).steps_lost == 7


@pytest.mark.parametrize("target", [1, 2, 3, 37, 4500])
def test_moves_end_exactly_where_they_must(bench, target):
    before = bench.pins().steps
    start = bench.stage.status().position_steps
    assert bench.move(target).position_steps == target
    assert bench.pins().steps - before == target - start
    bench.assert_true_position()


def test_a_move_goes_no_faster_than_it_is_told(bench):
    before = bench.pins().cycles
    bench.stage.move_to(100, 200.0)
    bench.wait(Moved)
    assert bench.pins().cycles - before >= 0.5 * 16_000_000


def test_a_place_outside_the_travel_is_refused_and_nothing_moves(bench):
    before = bench.pins().steps
    with pytest.raises(CommandRefusedError, match=r"0\.\.4500"):
        bench.stage.move_to(4501)
    assert bench.pins().steps == before


def test_a_second_activity_is_refused_while_the_first_runs(make_bench):
    bench = make_bench(pace=1.0, homed=False)
    bench.stage.move_to(2000)
    with pytest.raises(CommandRefusedError, match="moving"):
        bench.stage.move_to(0)
    bench.stage.stop()
    bench.wait(Stopped)


def test_a_stop_brakes_and_keeps_the_position(make_bench):
    bench = make_bench(pace=1.0)
    bench.stage.move_to(4000)
    bench.until(lambda: bench.pins().position - bench.offset > 200)
    bench.stage.stop()
    stopped = bench.wait(Stopped)
    assert stopped.position_steps < 3900 and stopped.position_trusted
    bench.assert_true_position()


def test_the_lamp_follows_its_command_and_is_dark_after_closing(bench):
    bench.stage.set_lamp(on=True)
    bench.until(lambda: bench.pins().lamp == 1)
    bench.stage.close()
    bench.until(lambda: bench.pins().lamp == 0, alive=False)


# ---- wiring that the configuration names ----


def test_a_switch_at_the_far_end_of_a_motor_that_turns_the_other_way_is_found(make_bench):
    bench = make_bench(homed=False, invert_direction=True, limit_switch="far")
    bench.stage.home()
    moved = bench.wait(Moved)
    assert moved.position_trusted and moved.position_steps == switch_position_steps(bench.config) - 50
    assert bench.pins().position == LIMIT_AT + 50
    bench.stage.check_limit()
    assert bench.wait(Moved).steps_lost == 0


def test_without_a_switch_the_stage_is_zeroed_by_hand_and_sweeps(make_bench):
    bench = make_bench(homed=False, limit_switch="none")
    assert not bench.info.has_limit_switch
    with pytest.raises(CommandRefusedError, match="then zero"):
        bench.stage.home()
    bench.stage.zero_here()
    assert bench.wait(Moved).position_trusted
    bench.stage.check_limit()
    assert bench.wait(Moved).steps_lost is None
    bench.stage.begin_segment(Segment(6, 3, 3), 2)
    assert bench.wait(SegmentDone).position_steps == 12
