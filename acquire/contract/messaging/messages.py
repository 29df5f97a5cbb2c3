"""Every message of every lane as a frozen struct with its bounds; what does not fit never gets past the codec.

It is long because it is one thing: the wire format, which has one version and one set of golden bytes.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta

from acquire.contract.plan import MAX_FRAMES, SweepPlan
from acquire.contract.states import Outcome

PROTOCOL = (1, 2)
"""Major and minor version of the wire format; another major is refused at the handshake."""

MAX_SIDE_PX = 16_384
MAX_FRAME_BYTES = 256 * 1024 * 1024
MAX_TEXT = 4096
MAX_LIST = MAX_FRAMES

Count = Annotated[int, Meta(ge=0, le=2**63 - 1)]
Id = Annotated[int, Meta(ge=-1, le=2**63 - 1)]
Int64 = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
FrameIndex = Annotated[int, Meta(ge=0, lt=MAX_FRAMES)]
Crc32 = Annotated[int, Meta(ge=0, le=2**32 - 1)]
Text = Annotated[str, Meta(max_length=MAX_TEXT)]
Name = Annotated[str, Meta(max_length=128)]
Verbatim = Annotated[str, Meta(max_length=4 * 1024 * 1024)]
Side = Annotated[int, Meta(ge=1, le=MAX_SIDE_PX)]
FrameRange = tuple[Annotated[int, Meta(ge=0, lt=MAX_FRAMES)], Annotated[int, Meta(ge=0, lt=MAX_FRAMES)]]
Ranges = Annotated[list[FrameRange], Meta(max_length=MAX_LIST)]

PixelFormat = Literal["mono", "rgb", "bayer_rggb", "bayer_bggr", "bayer_grbg", "bayer_gbrg"]
Purpose = Literal["object", "calibration", "raw"]
Role = Literal["sweep", "dark", "ambient", "repeat", "overlap"]


class FrameFormat(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Shape and type that all frames of a scan share."""

    width: Side
    """Pixels per row."""
    height: Side
    """Rows."""
    bit_depth: Annotated[int, Meta(ge=8, le=16)]
    """Significant bits; 8 is stored as uint8, 9..16 right-aligned in uint16."""
    pixel_format: PixelFormat = "mono"
    """``rgb`` has three values per pixel; ``bayer_*`` is stored raw and demosaiced on reading."""

    @property
    def shape(self) -> tuple[int, ...]:
        """[h, w] or [h, w, 3]."""
        return (self.height, self.width, 3) if self.pixel_format == "rgb" else (self.height, self.width)

    @property
    def dtype(self) -> Literal["|u1", "<u2"]:
        """numpy's name of the stored type, little endian."""
        return "|u1" if self.bit_depth == 8 else "<u2"

    @property
    def nbytes(self) -> int:
        """Bytes of one stored frame."""
        return self.height * self.width * (3 if self.pixel_format == "rgb" else 1) * (1 if self.bit_depth == 8 else 2)

    def mismatch(self, pixels: Any) -> str:
        """Why ``pixels`` (a numpy array) are no frame of this format, in words (F19); empty when they are one."""
        if pixels.shape != self.shape:
            return f"shape {pixels.shape} instead of {self.shape}"
        if pixels.dtype != self.dtype:
            return f"type {pixels.dtype} instead of {'uint8' if self.bit_depth == 8 else 'uint16'}"
        return "" if pixels.flags.c_contiguous else "rows that are not contiguous"


class Message(msgspec.Struct, frozen=True, kw_only=True, tag_field="type"):
    """The header fields of every message. Unknown keys are ignored: a newer minor version may add some."""

    protocol: tuple[int, int] = PROTOCOL
    """[major, minor] of the sender."""
    scan_uid: Name = ""
    """The scan that the message is about; empty where there is none."""
    seq: Count = 0
    """Counter of the sender on this lane; a jump is a gap."""
    epoch: Name = ""
    """The sender's boot id."""
    sent_mono_ns: Count = 0
    """CLOCK_MONOTONIC of the sender when it sent."""


# ---- frames lane: daemon -> writer (and the same `start`, `image`, `end` on the live lane) ----


class Start(Message, frozen=True, kw_only=True, tag="start"):
    """A scan begins (or is announced again to a writer that came back)."""

    path: Text
    """Absolute path of the scan's folder."""
    format: FrameFormat
    plan: SweepPlan
    config_toml: Verbatim = ""
    """The effective configuration, verbatim."""
    calibration_json: Verbatim = ""
    """The calibration, verbatim; empty where there is none."""
    user_json: Verbatim = "{}"
    """name, specimen, operator, notes, tags, purpose as JSON."""
    start_time_utc: Name = ""
    """ISO 8601 with Z."""
    epoch_utc_ns: Int64 = 0
    """UTC minus CLOCK_MONOTONIC at the start, in ns: what to add to exposure_start_ns."""
    versions_json: Text = "{}"
    reopen: bool = False
    """Go on with a scan that was stopped and sealed: the writer makes it partial again. Without it a seal is final."""


class Image(Message, frozen=True, kw_only=True, tag="image"):
    """One frame; the pixels are the second part of the message."""

    frame_index: FrameIndex
    role: Role = "sweep"
    """``sweep`` frames are counted; the others are kept beside them (dark, ambient, frame 0 repeated)."""
    attempt: Annotated[int, Meta(ge=0, le=255)] = 0
    """0 first take, then one more for each time it was taken again."""
    trigger_id: Id = -1
    camera_frame_id: Id = -1
    position_steps: Int64 = 0
    position_um: float = 0.0
    """Stage position at mid-exposure."""
    trigger_cycles: Count = 0
    """64-bit time of the trigger in cycles of the motion controller; 0 unknown."""
    exposure_start_ns: Count = 0
    """CLOCK_MONOTONIC of the daemon; 0 unknown."""
    shape: Annotated[list[Side], Meta(min_length=2, max_length=3)]
    dtype: Literal["|u1", "<u2"]
    bit_depth: Annotated[int, Meta(ge=8, le=16)] = 8
    pixel_format: PixelFormat = "mono"
    crc32: Crc32
    """Of the pixel bytes as stored."""


class End(Message, frozen=True, kw_only=True, tag="end"):
    """No more frames follow; what the source knows about all of them."""

    outcome: Outcome
    reason: Text = ""
    expected: Count
    sent: Count
    missing: Ranges = []
    """Frame ranges [first, last] that were never taken, both ends included."""
    retaken: Ranges = []
    digest: Name = ""
    counters: dict[Name, Int64] = {}
    """Every hop's counters; a jump says where a frame was lost."""
    checks: dict[Name, float] = {}
    """drift_px, brightness_change, steps_lost where they were measured."""


class Hello(Message, frozen=True, kw_only=True, tag="hello"):
    """A writer is there and can be given a scan (its routing id becomes known by this)."""

    service: Name = "writer"
    pid: Count = 0


class StartAck(Message, frozen=True, kw_only=True, tag="start_ack"):
    """The scan file exists, its space is reserved; what is in it already (after a restart)."""

    path: Text
    committed: Ranges = []
    """Frame ranges that are committed already."""
    crc32: Annotated[list[Crc32], Meta(max_length=MAX_LIST)] = []
    """Their checksums, in the order of the ranges."""
    durable_count: Count = 0
    reserved: bool = True
    """False where the file system cannot reserve space."""


class AckItem(msgspec.Struct, frozen=True, array_like=True):
    """One frame that is committed now."""

    frame_index: FrameIndex
    attempt: Annotated[int, Meta(ge=0, le=255)]
    crc32: Crc32
    role: Role = "sweep"


class Ack(Message, frozen=True, kw_only=True, tag="ack"):
    """Frames that are committed (survive the death of any process), and how many are durable."""

    frames: Annotated[list[AckItem], Meta(max_length=4096)]
    committed_count: Count
    durable_count: Count


class EndAck(Message, frozen=True, kw_only=True, tag="end_ack"):
    """The scan is sealed (or could not be, with the reason)."""

    path: Text
    sealed: bool
    outcome: Outcome
    committed: Count
    missing: Ranges = []
    digest: Name = ""
    reason: Text = ""


class Nack(Message, frozen=True, kw_only=True, tag="nack"):
    """A message that was refused, by name; the frame is still the sender's."""

    reason: Literal[
        "superseded",
        "no such scan",
        "shape",
        "crc",
        "immutable",
        "protocol",
        "no space",
        "io error",
        "exists",
        "busy",
    ]
    frame_index: Id = -1
    attempt: Annotated[int, Meta(ge=0, le=255)] = 0
    role: Role = "sweep"
    detail: Text = ""


# ---- status and command lanes ----


class FaultReport(msgspec.Struct, frozen=True, kw_only=True):
    """One fault as the operator reads it."""

    code: Name
    happened: Text
    safe: Text
    to_do: Text
    at_mono_ns: Count = 0
    acknowledged: bool = False
    scan: Name = ""
    """Folder name of the scan that it happened in; empty where there was none."""


class Proposal(msgspec.Struct, frozen=True, kw_only=True):
    """What a pre-scan proposes; nothing of it is taken over by itself."""

    first_steps: Int64
    """Position in microsteps where the light is about to reach the specimen."""
    last_steps: Int64
    """Position in microsteps where the light has left it."""
    exposure_ms: float
    """Exposure with which the brightest of the specimen stays below full scale, in ms."""
    frames: Count
    seconds: float
    """Estimated duration of the sweep in s."""
    nbytes: Count
    """Disk that the sweep needs."""
    free_bytes: Count
    """Disk that is free."""
    warnings: Annotated[list[Text], Meta(max_length=16)] = []
    """For the operator: lit in the first frame, dark in the last, saturated, too dark."""


class Status(Message, frozen=True, kw_only=True, tag="status"):
    """The whole state of the rig; the newest one wins."""

    state: Name
    hold_reason: Name = ""
    position_steps: Int64 = 0
    position_um: float = 0.0
    position_trusted: bool = False
    zero_id: Name = ""
    travel_steps: tuple[Int64, Int64] = (0, 0)
    stage_kind: Name = ""
    camera_kind: Name = ""
    lamp_on: bool = False
    camera: dict[Name, float] = {}
    """exposure_ms, gain, brightness_percent."""
    scan_path: Text = ""
    """Folder of the running or last scan; empty before the first."""
    plan: SweepPlan | None = None
    format: FrameFormat | None = None
    outcome: Name = ""
    expected: Count = 0
    triggered: Count = 0
    received: Count = 0
    committed: Count = 0
    durable: Count = 0
    retaken: Count = 0
    missing: Count = 0
    credit: Count = 0
    """Frames that may still be triggered before an ack must arrive."""
    window: Count = 0
    rate_hz: float = 0.0
    """Frames committed per second over the last seconds."""
    eta_s: float | None = None
    elapsed_s: float = 0.0
    writer_alive: bool = False
    counters: dict[Name, Int64] = {}
    faults: Annotated[list[FaultReport], Meta(max_length=64)] = []
    message: Text = ""
    """The last event, for the operator."""
    stage_version: Name = ""
    """Firmware of the motion controller; empty where it has none."""
    control: Name = ""
    """The client that holds control, by its name; empty: none, and any client may act."""
    activity: Name = ""
    """``preview``, ``exposure``, ``prescan`` ...: what runs while no scan does; empty: nothing."""
    activity_share: float = 0.0
    """How far a pre-scan or an exposure search is, 0..1."""
    proposal: Proposal | None = None
    """What the last pre-scan proposed; None before the first and once a scan has started."""
    lamp_warm_s: float = 0.0
    """Seconds until the lamp is warm; 0 when it is, or when it is off."""
    camera_limits: dict[Name, tuple[float, float]] = {}
    """[lowest, highest] of exposure_ms, gain, brightness_percent."""


class Command(Message, frozen=True, kw_only=True, tag="command"):
    """A request to the daemon; sent again with the same ``request_id`` it is done once."""

    request_id: Annotated[str, Meta(min_length=1, max_length=64)]
    name: Name
    args: dict[Name, Any] = {}
    client: Name = ""
    """The client's name for people (``anna on pts/3``); empty: a script that holds no control."""


class Reply(Message, frozen=True, kw_only=True, tag="reply"):
    """The one reply to a request."""

    request_id: Name
    ok: bool
    error: Text = ""
    result: dict[Name, Any] = {}


# ---- preview lane: daemon -> console, viewer ----


class Picture(Message, frozen=True, kw_only=True, tag="picture"):
    """The newest camera picture, reduced for display; uint8 pixels in the second part. Lossy."""

    shape: Annotated[list[Side], Meta(min_length=2, max_length=3)]
    """[h, w] or [h, w, 3] RGB of the reduced picture."""
    source_shape: Annotated[list[Side], Meta(min_length=2, max_length=2)]
    """[h, w] of the camera's frame."""
    frame_index: Id = -1
    """The frame of the running sweep; -1 in a preview."""
    position_steps: Int64 = 0
    position_um: float = 0.0
    exposure_ms: float = 0.0
    full_scale_share: float = 0.0
    """Share of the frame's pixels at full scale, 0..1."""
    low: float = 0.0
    """1st percentile of the frame in 8-bit counts."""
    high: float = 0.0
    """99.9th percentile of the frame in 8-bit counts."""


# ---- results lane: worker -> viewer, console ----


class ResultProgress(Message, frozen=True, kw_only=True, tag="result_progress"):
    """How far the fold is."""

    version: Count
    folded_through: Id
    expected: Count
    over_contrast: Count = 0
    points_settled: Count = 0
    points_provisional: Count = 0
    from_live: Count = 0
    from_file: Count = 0
    refolded: Count = 0
    lag_frames: Count = 0
    """Frames that the daemon sent and the worker has not folded yet."""
    message: Text = ""
    """What is missing, for the operator (no calibration, waiting for the file); empty if nothing is."""
    failed: bool = False
    """There are no maps and no cloud, for the reason in ``message``; the worker may try again."""


class TileHeader(msgspec.Struct, frozen=True, array_like=True):
    """One tile of the cloud: a rectangle of image pixels whose points follow in the payload."""

    tile: Annotated[int, Meta(ge=0, lt=65_536)]
    count: Annotated[int, Meta(ge=0, le=2**24)]
    provisional: Annotated[int, Meta(ge=0, le=2**24)]
    origin_mm: tuple[float, float, float]
    """Added to the float32 coordinates of the tile's points."""


class ResultTiles(Message, frozen=True, kw_only=True, tag="result_tiles"):
    """Tiles that changed; the second part holds their points in order (``messaging.point_record.POINT``)."""

    version: Count
    folded_through: Id
    snapshot: bool
    """True: these are all tiles, forget others; False: only what changed."""
    tiles: Annotated[list[TileHeader], Meta(max_length=4096)]


class ResultMaps(Message, frozen=True, kw_only=True, tag="result_maps"):
    """Every ``step``-th pixel of the maps so far; the second part: min <u2, max <u2, crossing <f4 in order."""

    version: Count
    folded_through: Id
    shape: Annotated[list[Side], Meta(min_length=2, max_length=2)]
    """[h, w] of each sampled map."""
    step: Annotated[int, Meta(ge=1, le=MAX_SIDE_PX)]
    """Distance of the samples in pixels, in both directions, from pixel 0; they are not averaged."""
    contrast: float
    """Threshold of the mask in counts of the stored depth."""
    bit_depth: Annotated[int, Meta(ge=8, le=16)] = 8


class ResultEnd(Message, frozen=True, kw_only=True, tag="result_end"):
    """Maps and cloud of a scan are on disk."""

    version: Count
    outcome: Name
    folded_through: Id
    points: Count
    maps_path: Text = ""
    cloud_path: Text = ""
    report_path: Text = ""
    seconds: float = 0.0
    """From the last frame to everything on disk."""
    message: Text = ""


AnyMessage = (
    Start | Image | End | Hello | StartAck | Ack | EndAck | Nack
    | Status | Command | Reply | Picture
    | ResultProgress | ResultTiles | ResultMaps | ResultEnd
)  # fmt: skip
"""By lane: frames (`start`, `image` and `end` on the live lane too); status, command, preview; results."""
