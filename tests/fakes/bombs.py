"""Messages that nobody should send: broken, hostile, or right at the wrong place; the same for the same seed."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import zmq

from acquire.contract.messaging.codec import encode
from acquire.contract.messaging.lanes import connect
from acquire.contract.messaging.messages import PROTOCOL, Command, Image, Nack
from acquire.contract.permissions import PERMISSIONS

LANES = {
    "command": zmq.DEALER,
    "frames": zmq.DEALER,
    **dict.fromkeys(("status", "live", "results", "preview"), zmq.XSUB),
}


def bombs(seed: int) -> Iterator[list[bytes]]:
    """Endless messages, each a list of parts."""
    source = random.Random(seed)
    while True:
        yield source.choice(_KINDS)(source)


def hit(run_dir: Path, *, count: int, seed: int) -> dict[str, int]:
    """Send ``count`` bombs to every socket that is there; returns how many left for each lane."""
    context = zmq.Context()
    sent = dict.fromkeys(LANES, 0)
    try:
        sockets = {
            lane: connect(context, kind, run_dir, lane)
            for lane, kind in LANES.items()
            if (run_dir / f"{lane}.sock").exists()
        }
        for parts, _ in zip(bombs(seed), range(count), strict=False):
            for lane, socket in sockets.items():
                # a subscriber can send as well: some of its bytes are read as subscriptions
                if socket.poll(1000, zmq.POLLOUT):
                    socket.send_multipart(parts)
                    sent[lane] += 1
        context.destroy(linger=2000)
    finally:
        context.destroy(linger=0)
    return sent


def _header(**fields: Any) -> dict[str, Any]:
    return {"type": "command", "protocol": list(PROTOCOL), "scan_uid": "", "seq": 1, "epoch": "x", **fields}


def _noise(source: random.Random) -> list[bytes]:
    return [source.randbytes(source.randrange(200))]


def _truncated(source: random.Random) -> list[bytes]:
    whole = encode(Command(request_id="r", name="status"))
    return [whole[: source.randrange(len(whole))]]


def _flipped(source: random.Random) -> list[bytes]:
    whole = bytearray(encode(source.choice([Command(request_id="r", name="stat"), Nack(reason="busy")])))
    whole[source.randrange(len(whole))] ^= 1 << source.randrange(8)
    return [bytes(whole)]


def _giant_claim(source: random.Random) -> list[bytes]:
    """A header that claims four thousand million elements, characters or bytes."""
    return [source.choice([b"\xdd", b"\xdf", b"\xdb", b"\xc6", b"\xc9"]) + b"\xff\xff\xff\xff" + b"\x01" * 8]


def _deep(source: random.Random) -> list[bytes]:
    return [b"\x91" * source.choice([600, 5000, 100_000]) + b"\x01"]


def _deep_field(source: random.Random) -> list[bytes]:
    deep: Any = 1
    for _ in range(source.choice([50, 400])):
        deep = [deep]
    return [msgpack.packb(_header(request_id="r", name="status", args={"x": deep}))]


def _bad_text(source: random.Random) -> list[bytes]:
    return [msgpack.packb({"type": "command"}).replace(b"command", b"comm\xff\xfed")]


def _unknown_type(source: random.Random) -> list[bytes]:
    return [msgpack.packb(_header(type=source.choice(["explode", "", 7, None, ["image"]])))]


def _other_version(source: random.Random) -> list[bytes]:
    return [msgpack.packb(_header(protocol=source.choice([[9, 0], [0, 1], "1.0", [], [1, 0, 0], [True, 2**70 % 7]])))]


def _many_parts(source: random.Random) -> list[bytes]:
    return [b""] * source.choice([1, 3, 20])


def _wrong_lane(source: random.Random) -> list[bytes]:
    image = Image(scan_uid="none", frame_index=0, shape=[4, 4], dtype="|u1", bit_depth=8, pixel_format="mono", crc32=1)
    return [encode(image), b"x" * 16]


def _big_part(source: random.Random) -> list[bytes]:
    return [encode(Command(request_id="r", name="status")), b"\0" * source.choice([10_000, 900_000])]


def _wild_command(source: random.Random) -> list[bytes]:
    name = source.choice([*PERMISSIONS, "explode"])
    value: Any = source.choice([10**15, -1, 1e308, float("nan"), "x" * 5000, [1] * 500, {"a": {}}, None, True])
    keys = "position_steps steps name exposure_ms path first_steps on rate_hz direction action every_steps nonsense"
    args = {"nonsense": 1, source.choice(keys.split()): value}
    client = source.choice(["", "mallory", "x" * 5000, 7])
    return [msgpack.packb(_header(request_id=str(source.random()), name=name, args=args, client=client))]


def _wrong_epoch(source: random.Random) -> list[bytes]:
    return [msgpack.packb({**_header(type="ack"), "frames": [[2**40, 0, 0]], "committed_count": -5})]


_KINDS: tuple[Callable[[random.Random], list[bytes]], ...] = (
    _noise, _truncated, _flipped, _giant_claim, _deep, _deep_field, _bad_text, _unknown_type, _other_version,
    _many_parts, _wrong_lane, _big_part, _wild_command, _wrong_epoch,
)  # fmt: skip
