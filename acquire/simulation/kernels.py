"""Owns how the simulation's kernels are compiled: once, kept on disk, and again when any source of theirs changes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

Compiled = TypeVar("Compiled", bound=Callable[..., Any])


def _sources_digest() -> bytes:
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(path.read_bytes())
    return digest.digest()


SOURCES_DIGEST = _sources_digest()
"""Of all modules of this package."""


def kernel(function: Compiled) -> Compiled:
    """Compile with numba, without the GIL, cached beside the source.

    Numba's cache notices a change of the function's own file only: a kernel that calls one of another module would
    keep the old one for ever. So the whole package's digest takes the place of the file's. Where no folder can be
    written (a locked-down service), kernels are compiled in each process.
    """
    try:
        dispatcher: Any = njit(cache=True, nogil=True)(function)
    except RuntimeError:
        return cast(Compiled, njit(nogil=True)(function))
    dispatcher._cache._cache_file._source_stamp = SOURCES_DIGEST
    return cast(Compiled, dispatcher)
