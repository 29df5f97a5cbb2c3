"""The files that cases are made of: good ones, and members of each kind of bad ones."""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tests.fakes.scans.small_scans import CALIBRATION, make_scan

BAD_BYTE = os.fsdecode(b"bad\xff")

CONFIGS: dict[str, bytes] = {
    "good.toml": b"[camera]\ngain = 3.5\n",
    "mark.toml": b"\xef\xbb\xbf[camera]\r\ngain = 3.5\r\n",
    "utf16.toml": "[camera]\ngain = 3.5\n".encode("utf-16"),
    "latin1.toml": b"[camera]\n# f\xfcr\n",
    "nul.toml": b"[camera]\0",
    "empty.toml": b"",
    "syntax.toml": b"[camera\n",
    "deep.toml": b"a = " + b"[" * 50_000,
    "digits.toml": b"[camera]\nwidth = " + b"9" * 9000,
    "unknown.toml": b"[camera]\ngian = 1\n",
    "section.toml": b"[kamera]\ngain = 1\n",
    "scalar.toml": b"camera = 1\n",
    "list.toml": b"[[camera]]\ngain = 1\n",
    "nan.toml": b"[camera]\nexposure_ms = nan\n",
    "inf.toml": b"[stage]\num_per_microstep = inf\n",
    "negative.toml": b"[sweep]\nmax_rate_hz = -0.0\n",
    "kind.toml": b'[stage]\nkind = "arduino"\n',
    "travel.toml": b"[stage]\ntravel_min_steps = 9\ntravel_max_steps = 9\n",
    "port.toml": b'[stage]\nkind = "uno"\nport = "/no/tty"\n[camera]\nkind = "replay"\ndevice = "pictures"\n',
    "legacy.toml": b'[stage]\nkind = "legacy"\nport = "/dev/null"\n[camera]\nkind = "replay"\ndevice = "pictures"\n',
    "device.toml": b'[camera]\nkind = "uvc"\ndevice = "/dev/video77"\n',
    "producer.toml": b'[camera]\nkind = "genicam"\nproducer = "/dev/null"\n[stage]\nkind = "uno"\n',
    "emulator.toml": b'[stage]\nkind = "uno"\nport = "emulator"\n[camera]\nkind = "replay"\ndevice = "good"\n',
    "home.toml": b'[storage]\ndata_dir = "~nobody-of-this-name/scans"\n',
    "file.toml": b'[storage]\ndata_dir = "good.toml"\n',
    "proc.toml": b'[storage]\ndata_dir = "/proc/nowhere"\n',
    "host.toml": b'[viewer]\nhost = "no such host"\n[network]\nhost = "256.256.256.256"\n',
    "calibration.toml": b'[reconstruct]\ncalibration = "/nonexistent.json"\n',
}


@dataclass(frozen=True)
class Corpus:
    """A folder with all of them; names are relative to it."""

    folder: Path
    scans: tuple[str, ...]
    folders: tuple[str, ...]
    files: tuple[str, ...]
    calibrations: tuple[str, ...]

    @property
    def paths(self) -> tuple[str, ...]:
        """Everything that a path can be."""
        return (*self.scans, *self.folders, *self.files, *self.calibrations, *CONFIGS)


def build(folder: Path) -> Corpus:
    """Make all files in ``folder``."""
    for name, content in CONFIGS.items():
        (folder / name).write_bytes(content)
    return Corpus(folder, _scans(folder), _folders(folder), _files(folder), _calibrations(folder))


def _scans(folder: Path) -> tuple[str, ...]:
    make_scan(folder / "good", calibration=CALIBRATION)
    make_scan(folder / "partial", 5, seal=False)
    make_scan(folder / "stopped", 3)
    whole = (folder / "good/scan.h5").read_bytes()
    for name, content in {
        "cut": whole[: len(whole) // 2],
        "none": b"",
        "zeros": b"\0" * 5000,
        "head": whole[:9000] + b"\xff" * (len(whole) - 9000),
    }.items():
        (folder / name).mkdir()
        (folder / name / "scan.h5").write_bytes(content)
    shutil.copytree(folder / "good", folder / BAD_BYTE)
    shutil.copytree(folder / "good", folder / "notes-broken")
    (folder / "notes-broken/notes.json").write_text("{")
    (folder / "notes-broken/report.json").write_bytes(b"\xff\xfe{")
    (folder / "notes-broken/maps.h5").write_bytes(b"no maps")
    (folder / "notes-broken/cloud.ply").write_bytes(b"ply\n")
    return ("good", "good/scan.h5", "partial", "stopped", "cut", "none", "zeros", "head", BAD_BYTE, "notes-broken")


def _folders(folder: Path) -> tuple[str, ...]:
    for name in ("pictures", "mixed", "empty", "boards", "unreadable"):
        (folder / name).mkdir()
    grey = np.arange(48 * 64, dtype=np.uint8).reshape(48, 64)
    for index in range(6):
        cv2.imwrite(str(folder / f"pictures/frame_{index:04}.png"), np.roll(grey, 7 * index, 1) // 2)
        cv2.imwrite(str(folder / f"mixed/left_{index}.png"), grey[: 40 + index])
    (folder / "mixed/._left_1.png").write_bytes(b"\0" * 50)
    (folder / f"mixed/{BAD_BYTE}.png").write_bytes(b"no picture")
    for index in range(3):
        (folder / f"unreadable/{index}.jpg").write_bytes(b"\xff\xd8\xff\xe0" + b"\0" * index)
        cv2.imwrite(str(folder / f"boards/{index}.png"), np.zeros((48, 64), np.uint8))
    (folder / "loop").symlink_to("loop")
    return ("pictures", "mixed", "empty", "boards", "unreadable", "loop", ".", "/", "/proc/self")


def _files(folder: Path) -> tuple[str, ...]:
    (folder / "text.txt").write_text("hello\n")
    (folder / "random.bin").write_bytes(np.random.default_rng(1).bytes(3000))
    os.mkfifo(folder / "pipe")
    return (
        *("text.txt", "random.bin", "pipe", "missing", "missing/below", "x" * 300, "new\nline", "-", "--", ""),
        *(
            "/dev/null",
            "/dev/zero",
            "/dev/full",
            "/proc/self/mem",
            BAD_BYTE + ".h5",
            "~nobody-of-this-name/x",
            "m\u00fc",
        ),
        *("/" + "y" * 5000, "text.txt/below", "/proc/nowhere/new.h5"),
    )


def _calibrations(folder: Path) -> tuple[str, ...]:
    text = json.dumps(CALIBRATION)
    flat = {**CALIBRATION, "light_plane": {**CALIBRATION["light_plane"], "normal": [0, 0, 0]}}  # type: ignore[dict-item]
    for name, content in {
        "c.json": text.encode(),
        f"c-{BAD_BYTE}.json": text.encode(),
        "c-mark.json": text.encode("utf-8-sig"),
        "c-utf16.json": text.encode("utf-16"),
        "c-nan.json": text.replace("0.001", "NaN").encode(),
        "c-huge.json": text.replace("0.001", "1e999").encode(),
        "c-flat.json": json.dumps(flat).encode(),
        "c-list.json": b"[1, 2]",
        "c-null.json": b"null",
        "c-deep.json": b"[" * 100_000,
        "c-surrogate.json": text.replace('"position_um"', '"\\udcff"').encode(),
        "c-cut.json": text[:100].encode(),
        "planes.json": b'{"reference_planes": {"marker_rectangle_mm": [1]}}',
    }.items():
        (folder / name).write_bytes(content)
    names = ("c.json", "mark", "utf16", "nan", "huge", "flat", "list", "null", "deep", "surrogate", "cut", BAD_BYTE)
    return (*(name if "." in name else f"c-{name}.json" for name in names), "planes.json")
