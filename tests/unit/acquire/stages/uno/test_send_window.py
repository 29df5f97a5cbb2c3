"""The send window: order, bounds, resends, and answers that belong to their command."""

from __future__ import annotations

from acquire.stages.uno.framing import Block
from acquire.stages.uno.send_window import QUEUE_MAX, SendWindow, SerialCommand, Timing
from acquire.stages.uno.wire_format import WINDOW_MAX, AckBody, Cmd, Msg, ReportBody, Result

TIMING = Timing(resend_s=1.0, resend_max_s=2.0, gap_pause_s=0.1)


def ack(sequence, result=Result.OK, expected=None):
    return Block(sequence, Msg.ACK, AckBody(result, (sequence + 1) & 0xFF if expected is None else expected).pack())


def filled(count):
    window = SendWindow(TIMING)
    commands = [SerialCommand(Cmd.LAMP, bytes([index])) for index in range(count)]
    for command in commands:
        assert window.put(command)
    return window, commands


def test_commands_go_out_in_order_and_no_more_than_the_window():
    window, _ = filled(6)
    assert [block.sequence for block in window.due(0.0)] == list(range(WINDOW_MAX))
    assert window.due(0.1) == []
    window.take(ack(0), 0.2)
    assert [block.body for block in window.due(0.3)] == [bytes([4])]


def test_a_lost_answer_stops_new_commands_before_the_firmware_forgets_its_result():
    window, _ = filled(20)
    window.due(0.0)
    for sequence in (1, 2, 3):
        window.take(ack(sequence), 0.1)
    assert window.due(0.2) == []
    window.take(ack(0), 0.3)
    assert [block.sequence for block in window.due(0.4)] == [4, 5, 6, 7]


def test_an_answer_completes_its_own_command_only():
    window, commands = filled(3)
    window.due(0.0)
    window.take(ack(1), 0.1)
    assert [command.answer.done() for command in commands] == [False, True, False]
    assert commands[1].answer.result().kind == Msg.ACK


def test_unanswered_commands_go_again_with_growing_waits():
    window, _ = filled(2)
    window.due(0.0)
    assert window.due(0.9) == []
    assert [block.sequence for block in window.due(1.0)] == [0, 1]
    assert window.due(2.0) == []
    assert len(window.due(2.6)) == 2
    assert window.resent == 4


def test_a_gap_is_filled_at_once_but_not_in_a_storm():
    window, _ = filled(3)
    window.due(0.0)
    assert len(window.take(ack(2, Result.GAP, 0), 0.2)) == 3
    assert window.take(ack(2, Result.GAP, 0), 0.25) == []
    assert len(window.take(ack(0, Result.BAD_BLOCK, 0), 0.35)) == 3


def test_a_report_that_nobody_asked_for_is_no_answer():
    window = SendWindow(TIMING)
    status = SerialCommand(Cmd.STATUS, b"")
    window.put(status)
    window.due(0.0)
    unasked = ReportBody(*([0] * 16))
    window.take(Block(0, Msg.REPORT, unasked.pack()), 0.1)
    assert not status.answer.done()
    window.take(Block(0, Msg.REPORT, ReportBody(1, *([0] * 15)).pack()), 0.2)
    assert status.answer.done()


def test_a_report_never_answers_a_command_that_asked_for_none():
    window, commands = filled(1)
    window.due(0.0)
    window.take(Block(0, Msg.REPORT, ReportBody(1, *([0] * 15)).pack()), 0.1)
    assert not commands[0].answer.done()


def test_sequence_numbers_wrap_and_start_again_with_a_session():
    window = SendWindow(TIMING)
    for index in range(300):
        command = SerialCommand(Cmd.LAMP, b"")
        window.put(command)
        (block,) = window.due(float(index))
        assert block.sequence == index & 0xFF
        window.take(ack(block.sequence), float(index))
        assert command.answer.done()
    left = SerialCommand(Cmd.STOP, b"")
    window.put(left)
    assert window.reset() == [left] and window.idle
    window.put(SerialCommand(Cmd.LAMP, b""))
    assert window.due(400.0)[0].sequence == 0


def test_the_queue_is_bounded():
    window, _ = filled(QUEUE_MAX)
    assert not window.put(SerialCommand(Cmd.LAMP, b""))


def test_bytes_in_flight_are_bounded():
    window = SendWindow(TIMING)
    for _ in range(4):
        window.put(SerialCommand(Cmd.SEGMENT, bytes(37)))
    assert len(window.due(0.0)) == 2
