"""Starts a service as the command line does, with a protection switched off or a fault injected where a test wants it.

    python -m tests.faults.launch writer

$SWEEPSCOPE_TEST_SABOTAGE names the protection, $SWEEPSCOPE_TEST_INJECT the fault; no product code knows of either.
"""

from __future__ import annotations

import errno
import os
import sys
from pathlib import Path
from typing import Any


def inject(name: str) -> None:
    """Faults of the machine that last as long as the flag file exists."""
    flag = Path(os.environ["SWEEPSCOPE_TEST_FLAG"])
    if name == "other firmware":
        from acquire import twin
        from acquire.stages.emulator import build_firmware

        folder = Path(os.environ["TMPDIR"]) / "firmware"
        twin.build_firmware = lambda: build_firmware(folder, "DEFINES=-DPROTOCOL_MAJOR=9")
    if name in ("EIO", "ENOSPC"):
        from acquire import scan_store

        real, number = scan_store.write_at, getattr(errno, name)

        def write_at(fd: int, data: Any, offset: int) -> None:
            if flag.exists():
                raise OSError(number, os.strerror(number))
            real(fd, data, offset)

        scan_store.write_at = write_at


def main() -> int:
    """Run the service named on the command line."""
    from tests.faults.sabotage import PROTECTIONS
    from tui.cli import run

    if os.environ.get("SWEEPSCOPE_TEST_INJECT"):
        inject(os.environ["SWEEPSCOPE_TEST_INJECT"])
    if os.environ.get("SWEEPSCOPE_TEST_SABOTAGE"):
        PROTECTIONS[os.environ["SWEEPSCOPE_TEST_SABOTAGE"]].switch_off()
    return run(sys.argv[1:])


if __name__ == "__main__":
    sys.exit(main())
