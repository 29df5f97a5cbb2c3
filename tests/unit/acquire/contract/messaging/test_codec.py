"""The wire format: golden bytes of version 1, and what is refused."""

from __future__ import annotations

import tracemalloc

import msgpack
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from acquire.contract.errors import ProtocolError
from acquire.contract.messaging import codec
from acquire.contract.messaging.codec import ProtocolMismatchError, decode, decode_as, encode
from acquire.contract.messaging.messages import (
    Ack,
    AckItem,
    Command,
    End,
    EndAck,
    FrameFormat,
    Hello,
    Image,
    Nack,
    Picture,
    Reply,
    ResultEnd,
    ResultMaps,
    ResultProgress,
    ResultTiles,
    Start,
    StartAck,
    Status,
    TileHeader,
)
from acquire.contract.plan import SweepPlan
from acquire.contract.states import Outcome
from tests import ROOT

GOLDEN = ROOT / "tests" / "golden"
PLAN = SweepPlan(first_steps=0, last_steps=1578, steps_per_frame=3, um_per_microstep=3.175)
FORMAT = FrameFormat(width=1024, height=768, bit_depth=8, pixel_format="rgb")
HEADER = {"scan_uid": "0123abcd", "seq": 7, "epoch": "boot", "sent_mono_ns": 123456789}
MESSAGES = {
    "start": Start(path="/data/x", format=FORMAT, plan=PLAN, start_time_utc="2026-01-02T03:04:05.678Z", **HEADER),
    "image": Image(
        frame_index=5, attempt=1, trigger_id=9, camera_frame_id=11, position_steps=15, position_um=47.625,
        trigger_cycles=2**40, exposure_start_ns=2**50, shape=[768, 1024, 3], dtype="|u1", pixel_format="rgb",
        crc32=0xDEADBEEF, **HEADER,
    ),
    "end": End(
        outcome=Outcome.STOPPED, reason="why", expected=527, sent=412, missing=[(412, 526)], retaken=[(3, 3)],
        digest="ab" * 32, counters={"lost": 1}, checks={"drift_px": 0.25}, **HEADER,
    ),
    "hello": Hello(pid=42, **HEADER),
    "start_ack": StartAck(path="/data/x", committed=[(0, 1)], crc32=[1, 2], durable_count=1, **HEADER),
    "ack": Ack(frames=[AckItem(5, 1, 7), AckItem(0, 0, 8, "ambient")], committed_count=6, durable_count=2, **HEADER),
    "end_ack": EndAck(path="/data/x", sealed=True, outcome=Outcome.COMPLETE, committed=527, **HEADER),
    "nack": Nack(reason="immutable", frame_index=3, detail="frame 3 is committed", **HEADER),
    "status": Status(state="idle", plan=PLAN, format=FORMAT, camera={"gain": 6.0}, **HEADER),
    "command": Command(request_id="r1", name="goto", args={"position_steps": 3}, **HEADER),
    "reply": Reply(request_id="r1", ok=False, error="no", result={"a": 1}, **HEADER),
    "result_progress": ResultProgress(version=1, folded_through=-1, expected=527, **HEADER),
    "result_tiles": ResultTiles(
        version=2, folded_through=9, snapshot=True, tiles=[TileHeader(3, 10, 2, (0.5, 1.0, -1.0))], **HEADER
    ),
    "picture": Picture(shape=[192, 256], source_shape=[768, 1024], frame_index=4, full_scale_share=0.25, **HEADER),
    "result_maps": ResultMaps(version=4, folded_through=9, shape=[384, 512], step=2, contrast=70.0, **HEADER),
    "result_end": ResultEnd(version=3, outcome="complete", folded_through=526, points=75151, seconds=0.2, **HEADER),
}  # fmt: skip


@pytest.mark.parametrize("name", MESSAGES)
def test_a_message_survives_the_wire(name):
    assert decode(encode(MESSAGES[name])) == MESSAGES[name]


@pytest.mark.parametrize("name", sorted(path.stem for path in (GOLDEN / "protocol-1").iterdir()))
def test_the_golden_bytes_of_version_1_0_still_mean_the_same(name):
    assert decode((GOLDEN / "protocol-1" / f"{name}.bin").read_bytes()) == replace(MESSAGES[name], protocol=(1, 0))


@pytest.mark.parametrize("name", sorted(path.stem for path in (GOLDEN / "protocol-1.1").iterdir()))
def test_the_golden_bytes_of_version_1_1_still_mean_the_same(name):
    assert decode((GOLDEN / "protocol-1.1" / f"{name}.bin").read_bytes()) == replace(MESSAGES[name], protocol=(1, 1))


@pytest.mark.parametrize("name", MESSAGES)
def test_the_golden_bytes_of_version_1_2_still_mean_the_same(name):
    golden = (GOLDEN / "protocol-1.2" / f"{name}.bin").read_bytes()
    assert decode(golden) == MESSAGES[name]
    assert encode(MESSAGES[name]) == golden


def test_a_newer_minor_version_with_a_key_that_we_do_not_know_is_read():
    fields = msgpack.unpackb(encode(MESSAGES["hello"])) | {"protocol": [1, 9], "novelty": 1}
    assert isinstance(decode(msgpack.packb(fields)), Hello)


def test_another_major_version_is_refused_and_both_are_named():
    fields = msgpack.unpackb(encode(MESSAGES["hello"])) | {"protocol": [2, 0]}
    with pytest.raises(ProtocolMismatchError, match=r"2\.0.*1\.2"):
        decode(msgpack.packb(fields))


@pytest.mark.parametrize(
    "raw",
    [
        b"", b"\xc1", b"\x91" * 100_000, b"\x81\xa4type\xa1\xff", b"\xdf\xff\xff\xff\xff", b"\xc6\xff\xff\xff\xff",
        msgpack.packb([1, 2]), msgpack.packb({"type": "nonsense", "protocol": [1, 0]}), msgpack.packb({"type": "ack"}),
        msgpack.packb({"type": 5, "protocol": [1, 0]}), msgpack.packb({"type": "hello", "protocol": "1.0"}),
        msgpack.packb({1: 2}), encode(Hello())[:-1], encode(Hello()) + b"x",
    ],
)  # fmt: skip
def test_what_is_no_message_raises_one_class_of_error(raw):
    with pytest.raises(ProtocolError):
        decode(raw)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("image", {"frame_index": -1}),
        ("image", {"frame_index": 10**9}),
        ("image", {"crc32": 2**32}),
        ("image", {"shape": [10**9, 4]}),
        ("image", {"dtype": "|O"}),
        ("image", {"position_um": "far"}),
        ("end", {"outcome": "success"}),
        ("command", {"request_id": ""}),
        ("start", {"plan": {"first_steps": 0}}),
    ],
)
def test_a_field_out_of_bounds_is_refused(name, change):
    fields = msgpack.unpackb(encode(MESSAGES[name])) | change
    with pytest.raises(ProtocolError, match=name):
        decode(msgpack.packb(fields))


@pytest.mark.parametrize(
    "value",
    [
        b"\x91" * 100_000, b"\xdd\xff\xff\xff\xff", b"\xdf\xff\xff\xff\xff", b"\xc7\x01\x05x", b"\xa1\xff",
        b"\xdb\xff\xff\xff\xff",
    ],
    ids=["too deep", "huge array", "huge map", "extension", "bad UTF-8", "huge text"],
)  # fmt: skip
def test_what_hides_in_the_arguments_of_a_command_is_refused_without_memory_for_it(value):
    known = msgpack.packb({"type": "command", "protocol": [1, 1], "request_id": "r", "name": "goto"})
    raw = bytes([known[0] + 1]) + known[1:] + msgpack.packb("args") + b"\x81" + msgpack.packb("x") + value
    tracemalloc.start()
    try:
        with pytest.raises(ProtocolError):
            decode(raw)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()


def test_a_header_without_a_version_is_refused():
    fields = msgpack.unpackb(encode(MESSAGES["hello"]))
    del fields["protocol"]
    with pytest.raises(ProtocolError, match="protocol"):
        decode(msgpack.packb(fields))


def test_a_header_over_the_bound_is_refused_unread():
    with pytest.raises(ProtocolError, match="bound"):
        decode(bytes(codec.MAX_HEADER_BYTES + 1))


@given(st.binary(max_size=200))
def test_random_bytes_never_raise_anything_else(raw):
    try:
        decode(raw)
    except ProtocolError:
        return
    pytest.fail("random bytes were taken for a message")


def test_a_message_of_another_lane_is_refused():
    with pytest.raises(ProtocolError, match="lane"):
        decode_as(encode(MESSAGES["ack"]), Command)
