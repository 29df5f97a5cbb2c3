"""Each protection of the appliance switched off by itself: the row that it protects must then fail."""

from __future__ import annotations

import os
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Protection:
    """One protection, the rows that must notice its absence, and how to take it away."""

    row: str
    what: str
    switch_off: Callable[[], None]


def _replace(owner: Any, name: str, value: Any) -> None:
    if not hasattr(owner, name):
        raise LookupError(f"{owner} has no {name} any more: the protection is taken away somewhere else now")
    setattr(owner, name, value)


def _ack_before_write() -> None:
    from acquire.writer.scan_file import ScanFile

    real, waiting = ScanFile.write_frame, []

    def write_frame(self: Any, image: Any, pixels: Any) -> str:
        waiting.append((image, bytes(pixels)))
        if len(waiting) > 20:
            real(self, *waiting.pop(0))
        return "committed"

    _replace(ScanFile, "write_frame", write_frame)


def _status_before_pixels() -> None:
    from acquire.writer.scan_file import ScanFile

    real = ScanFile._put_pixels

    def put_pixels(self: Any, region: str, index: int, raw: Any) -> None:
        if region == "data":
            self._put("status", index, 1)
            time.sleep(0.02)
        real(self, region, index, raw)

    _replace(ScanFile, "_put_pixels", put_pixels)


def _no_replay() -> None:
    from acquire.daemon.frame_sender import FrameSender

    _replace(FrameSender, "_replay", lambda _self: None)


def _no_verification() -> None:
    from acquire.writer.frame_store import ScanStore

    _replace(ScanStore, "check_frames", lambda _self, _first=0: [])


def _no_lock() -> None:
    import fcntl

    _replace(fcntl, "flock", lambda *_args: None)


def _no_credit() -> None:
    from acquire.sweep.credit_window import CreditWindow

    _replace(CreditWindow, "may_trigger_through", lambda _self: 10**9)


def _no_pairing() -> None:
    from acquire.sweep.pairing import Match, Pairing

    def match(self: Any, *_args: object, **_more: object) -> Match:
        return Match(self.pending.popleft() if self.pending else None)

    _replace(Pairing, "match", match)


def _no_look_at_times() -> None:
    from acquire.sweep.pairing import Pairing

    _replace(Pairing, "_is_too_late", lambda *_args: False)


def _no_retake() -> None:
    from acquire.sweep import state_machine

    _replace(state_machine, "_retake", lambda *_args: [])


def _no_format_check() -> None:
    from acquire.contract.messaging.messages import FrameFormat
    from acquire.writer.scan_file import ScanFile

    _replace(FrameFormat, "mismatch", lambda *_args: "")
    _replace(ScanFile, "_check", lambda *_args: None)


def _no_light_monitor() -> None:
    from acquire.sweep.checks.light_monitor import LightMonitor

    _replace(LightMonitor, "update", lambda *_args: None)


def _no_time_watch() -> None:
    from acquire.daemon.clock_watch import ClockWatch

    _replace(ClockWatch, "update", lambda *_args: [])


def _wall_clock() -> None:
    from acquire.contract.process.clocks import MonotonicClock, epoch_utc_ns

    at_start_ns = epoch_utc_ns()
    _replace(MonotonicClock, "now_ns", lambda _self: time.time_ns() - at_start_ns)


def _no_reservation() -> None:
    from acquire.daemon import scan_setup
    from acquire.writer import create_file

    _replace(create_file, "_probe", lambda *_args: None)
    _replace(create_file, "reserve", lambda *_args: False)
    real = scan_setup.space_for
    _replace(scan_setup, "space_for", lambda *args: (real(*args)[0], 10**18))


def _no_link_count() -> None:
    import os

    real = os.fstat

    class _Linked:
        def __init__(self, found: Any) -> None:
            self._found = found

        def __getattr__(self, name: str) -> Any:
            return 1 if name == "st_nlink" else getattr(self._found, name)

    _replace(os, "fstat", lambda fd: _Linked(real(fd)))


def _no_calibration_check() -> None:
    from acquire.daemon import scan_setup

    _replace(scan_setup, "check_size", lambda *_args: None)
    _replace(scan_setup, "check_validity", lambda *_args: [])


def _no_signal_handler() -> None:
    import signal

    _replace(signal, "signal", lambda *_args: None)


def _no_bounds() -> None:
    from acquire.contract.messaging import codec

    _replace(codec, "MALFORMED", ())


def _no_writer_time_out() -> None:
    from acquire.sweep import state_machine

    real = state_machine._time_is_up

    def time_is_up(sweep: Any, now_ns: int) -> Any:
        return [] if sweep.phase.name == "WAIT_WRITER" else real(sweep, now_ns)

    _replace(state_machine, "_time_is_up", time_is_up)


def _no_mark() -> None:
    from acquire.writer.session import WriterSession

    _replace(WriterSession, "leave_orphan", lambda _self: None)


def _no_file_lane() -> None:
    from process.results.fold_cursor import FoldCursor

    _replace(FoldCursor, "fill", lambda *_args, **_kwargs: 0)


def _blocking_live_lane() -> None:
    import zmq

    from acquire.contract.messaging import lanes

    real = lanes.bind

    def bind(context: Any, kind: int, run_dir: Any, lane: str) -> Any:
        if lane != "live":
            return real(context, kind, run_dir, lane)
        socket = lanes.open_socket(context, kind, lane)
        socket.setsockopt(zmq.XPUB_NODROP, 1)
        socket.setsockopt(zmq.SNDHWM, 2)
        socket.bind(lanes.endpoint(run_dir, lane))
        return socket

    _replace(lanes, "bind", bind)
    from acquire.daemon import service

    _replace(service, "bind", bind)
    real_send = lanes.Sender.send

    def send(self: Any, message: Any, payload: Any = None, *, routing_id: Any = None) -> bool:
        if payload is None or routing_id is not None:
            return real_send(self, message, payload, routing_id=routing_id)
        while not real_send(self, message, payload):
            time.sleep(0.01)
        return True

    _replace(lanes.Sender, "send", send)


def _one_client_only() -> None:
    from acquire.daemon.commands.command_server import CommandServer

    real, known = CommandServer._answer, set()

    def answer(self: Any, received: Any) -> None:
        known.add(received.routing_id)
        if len(known) > 40:
            raise RuntimeError("too many clients")
        real(self, received)

    _replace(CommandServer, "_answer", answer)


def _no_comparison_by_the_worker() -> None:
    from process.results.fold_cursor import FoldCursor

    _replace(FoldCursor, "differs_from", lambda *_args: [])


def _no_crc_on_arrival() -> None:
    from acquire.writer import scan_file

    real = scan_file.frame_crc32
    _replace(scan_file, "frame_crc32", lambda raw: _Equal(real(raw)))


class _Equal(int):
    def __ne__(self, other: object) -> bool:
        return False

    __hash__ = int.__hash__


def _no_crc_on_the_line() -> None:
    from cobs import cobs

    from acquire.stages.uno import framing, link

    def decode(encoded: bytes) -> Any:
        try:
            raw = cobs.decode(encoded)
        except cobs.DecodeError:
            return None
        return framing.Block(raw[1], raw[2], raw[3:-4]) if len(raw) >= framing.BLOCK_OVERHEAD else None

    _replace(framing, "decode_block", decode)
    assert link.BlockReader is framing.BlockReader


def _no_reconnect() -> None:
    from acquire.stages.uno.link import Link

    def lose(self: Any, detail: str) -> None:
        self._nonce = 0
        self._handler.on_lost(detail)
        self._closing = True

    _replace(Link, "_lose", lose)


def _no_boot_id() -> None:
    from acquire.stages.uno.reports import ReportFollower

    real = ReportFollower.on_back
    _replace(ReportFollower, "on_back", lambda self, hello, same_session: real(self, hello, same_session=True))


def _no_handshake() -> None:
    from acquire.stages.uno import handshake

    class Any_(int):
        def __eq__(self, other: object) -> bool:
            return True

        def __ne__(self, other: object) -> bool:
            return False

        __hash__ = int.__hash__

    _replace(handshake, "PROTOCOL_MAJOR", Any_(handshake.PROTOCOL_MAJOR))
    _replace(handshake, "WIRE_CRC", Any_(handshake.WIRE_CRC))


def _no_lease() -> None:
    from acquire.rigs import twin
    from acquire.stages.uno import config as uno_config
    from acquire.stages.uno import wire_format as wire

    real = uno_config.config_body
    from acquire.stages.uno import stage as uno_stage

    longest = wire.LEASE_MAX_MS
    import msgspec

    _replace(uno_stage, "config_body", lambda config: real(msgspec.structs.replace(config, motion_lease_ms=longest)))
    assert twin.TwinStage


def _no_alarm() -> None:
    from acquire.stages.protocol import Alarm
    from acquire.sweep.state_machine import HANDLERS

    HANDLERS[Alarm] = lambda *_args: []


def can_be_taken_away(name: str) -> bool:
    """Whether a protection is still where it is looked for: in a child, because it is gone afterwards."""
    child = os.fork()
    if child:
        return os.waitpid(child, 0)[1] == 0
    try:
        PROTECTIONS[name].switch_off()
    except BaseException:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


PROTECTIONS: dict[str, Protection] = {
    "resume needs the mark of an interruption": Protection("F01", "mark of an interrupted scan", _no_mark),
    "notice of a freeze": Protection("F02", "notice of a frozen daemon", _no_time_watch),
    "ack after write": Protection("F03", "the ack follows the write", _ack_before_write),
    "replay": Protection("F03", "un-acked frames are sent again", _no_replay),
    "pixels before status": Protection("F03", "the commit record is written last", _status_before_pixels),
    "credit": Protection("F04", "no credit, no trigger", _no_credit),
    "writer time-out": Protection("F05", "a sweep without a writer is refused in time", _no_writer_time_out),
    "reservation": Protection("F06", "the file's space is reserved first", _no_reservation),
    "link count": Protection("F07", "a deleted file takes no frames", _no_link_count),
    "gaps from the file": Protection("F08", "the worker fills gaps from the file", _no_file_lane),
    "comparison by the worker": Protection("F08", "the fold is compared with the file", _no_comparison_by_the_worker),
    "lossy live lane": Protection("F09", "the live lane drops instead of waiting", _blocking_live_lane),
    "any number of clients": Protection("F10", "a client costs nothing", _one_client_only),
    "checksum on the line": Protection("F11", "a damaged block is thrown away", _no_crc_on_the_line),
    "reconnect": Protection("F12", "a controller that comes back is taken back", _no_reconnect),
    "boot id": Protection("F13", "a controller that restarted is not trusted", _no_boot_id),
    "handshake": Protection("F14", "another firmware is refused", _no_handshake),
    "lease": Protection("F15", "the controller holds when it does not hear the host", _no_lease),
    "retake": Protection("F16", "a lost frame is taken again", _no_retake),
    "times of frames": Protection("F16", "a frame is no trigger's that it is too late for", _no_look_at_times),
    "pairing": Protection("F17", "frames are paired by ids", _no_pairing),
    "retake after a restart": Protection("F18", "a lost frame is taken again", _no_retake),
    "format check": Protection("F19", "a frame of another shape is refused", _no_format_check),
    "checksum on arrival": Protection("F19", "a frame that changed on its way is refused", _no_crc_on_arrival),
    "bounds of messages": Protection("F20", "messages are checked at the boundary", _no_bounds),
    "calibration check": Protection("F21", "a calibration that cannot be meant is refused", _no_calibration_check),
    "monotonic clock": Protection("F22", "time-outs go by the monotonic clock", _wall_clock),
    "alarm": Protection("F23", "an alarm of the controller ends the sweep", _no_alarm),
    "signal handler": Protection("F24", "a service that is told to end says an end", _no_signal_handler),
    "verification": Protection("F25", "frames are compared with their checksums", _no_verification),
    "lock": Protection("F26", "one process of a kind", _no_lock),
    "light monitor": Protection("F27", "the light is watched", _no_light_monitor),
}
