"""Owns replacing a result on disk: written under a temporary name, then renamed; a reader never sees half a file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from acquire.contract.errors import SweepscopeError


class ResultWriteError(SweepscopeError):
    """A result could not be written; what stood there before is untouched."""


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A temporary path beside ``target`` that takes its place when the block ends without an error.

    Results can be made again from the scan, so they are not forced onto the disk.

    Raises:
        ResultWriteError: the folder is missing, full or not writable.
    """
    temporary = target.with_name(f".{target.name}.{os.getpid()}.tmp")
    try:
        yield temporary
        temporary.replace(target)
    except OSError as error:
        why = error.strerror or str(error).splitlines()[0]
        raise ResultWriteError(
            f"cannot write {target}: {why}; the scan is safe, make room or choose another folder with --out"
        ) from None
    finally:
        temporary.unlink(missing_ok=True)
