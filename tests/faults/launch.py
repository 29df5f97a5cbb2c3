"""Starts a service as the command line does, with a protection switched off or a fault injected where a test wants it.

    python -m tests.faults.launch writer

$SWEEPSCOPE_TEST_SABOTAGE names the protection, $SWEEPSCOPE_TEST_INJECT the fault; no product code knows of either.
"""

from __future__ import annotations

import errno
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec


def inject(name: str, flag: Path) -> None:
    """Switch one fault on, for as long as the flag file exists where it is one that can end."""
    INJECTIONS[name](flag)


def _disk_says(number: int) -> Callable[[Path], None]:
    def install(flag: Path) -> None:
        from acquire.writer import frame_store as scan_store

        real = scan_store.write_at

        def write_at(fd: int, data: Any, offset: int) -> None:
            if flag.exists():
                raise OSError(number, os.strerror(number))
            real(fd, data, offset)

        scan_store.write_at = write_at

    return install


def _other_firmware(_flag: Path) -> None:
    from acquire.rigs import twin
    from acquire.stages.uno.emulator import build_firmware

    folder = Path(os.environ["TMPDIR"]) / "firmware"
    twin.build_firmware = lambda: build_firmware(folder, "DEFINES=-DPROTOCOL_MAJOR=9")


def _bits_flip(_flag: Path) -> None:
    """Every twentieth frame reaches the writer with a bit flipped, the first time that it comes."""
    from acquire.writer.session import WriterSession

    real, seen = WriterSession.image, set()

    def image(self: Any, message: Any, pixels: Any) -> None:
        if message.frame_index % 20 == 7 and message.frame_index not in seen:
            seen.add(message.frame_index)
            pixels = bytearray(pixels)
            pixels[len(pixels) // 2] ^= 4
        real(self, message, memoryview(pixels))

    WriterSession.image = image


def _live_lane_lies(flag: Path) -> None:
    """The worker hears of other pixels than the writer, whole in themselves."""
    from acquire.contract.scan_data.checksums import frame_crc32
    from acquire.daemon.scan_runner import RunningScan

    def publish(self: Any, image: Any, pixels: Any) -> None:
        self._lane.offer(image, pixels)
        if flag.exists() and image.role == "sweep" and image.frame_index % 30 == 9:
            pixels = 255 - pixels
            image = msgspec.structs.replace(image, crc32=frame_crc32(pixels))
        self._live.send(image, pixels)

    RunningScan._publish = publish


def _cleanup_fails(_flag: Path) -> None:
    from acquire.cameras.simulated import SimulatedCamera
    from acquire.contract.errors import CommandRefusedError

    def fails(_self: Any) -> None:
        raise CommandRefusedError("the camera does not listen any more")

    SimulatedCamera.disarm = fails


INJECTIONS: dict[str, Callable[[Path], None]] = {
    "EIO": _disk_says(errno.EIO),
    "ENOSPC": _disk_says(errno.ENOSPC),
    "cleanup fails": _cleanup_fails,
    "other firmware": _other_firmware,
    "bits flip": _bits_flip,
    "the live lane lies": _live_lane_lies,
}


def main() -> int:
    """Run the service named on the command line."""
    from tests.faults.sabotage import PROTECTIONS
    from tui.cli import run

    if os.environ.get("SWEEPSCOPE_TEST_INJECT"):
        inject(os.environ["SWEEPSCOPE_TEST_INJECT"], Path(os.environ["SWEEPSCOPE_TEST_FLAG"]))
    if os.environ.get("SWEEPSCOPE_TEST_SABOTAGE"):
        PROTECTIONS[os.environ["SWEEPSCOPE_TEST_SABOTAGE"]].switch_off()
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
