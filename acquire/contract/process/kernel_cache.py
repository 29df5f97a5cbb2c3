"""Compile numeric kernels with numba once, keep them on disk, and compile them again when any source changes."""

from __future__ import annotations

import functools
import hashlib
import logging
import pickle
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, TypeVar, cast

from numba import njit

Compiled = TypeVar("Compiled", bound=Callable[..., Any])
logger = logging.getLogger(__name__)
_DAMAGED: Final = (
    OSError, EOFError, ValueError, TypeError, KeyError, IndexError, AttributeError, ImportError, pickle.PickleError,
)  # fmt: skip
"""What numba's cache raises for a file that was cut short, and for a disk that is full or went read-only."""


def digest_of(sources: Iterable[Path]) -> bytes:
    """sha256 over the content of the files in which kernels and what they call are defined."""
    digest = hashlib.sha256()
    for path in sorted(sources):
        digest.update(path.read_bytes())
    return digest.digest()


def kernel_decorator(digest: bytes, *, inline: bool = False) -> Callable[[Compiled], Compiled]:
    """A decorator that compiles a function without the interpreter lock, cached beside its source.

    Numba's cache notices a change of the function's own file only. A kernel that calls one of another module would
    keep the old one, and a stale mixture of the two could write past its arrays. So ``digest``, that of all sources,
    takes the place of the file's time stamp in the cache. Where no folder can be written (a locked-down service, a
    read-only home), kernels are compiled in each process, and one line says so.
    """
    options: dict[str, Any] = {"nogil": True, "inline": "always" if inline else "never"}

    def compiled(function: Compiled) -> Compiled:
        try:
            dispatcher: Any = njit(cache=True, **options)(function)
        except RuntimeError:
            _say_uncached("no folder for them can be written to")
            return cast(Compiled, njit(**options)(function))
        cache_file = dispatcher._cache._cache_file
        cache_file._source_stamp = digest
        # Numba compares its version before it unpickles the rest of an index. With the digest in it, an old index is
        # not unpickled at all: the types that a kernel takes may have been renamed since.
        cache_file._version = f"{cache_file._version} {digest.hex()}"
        _tolerate_damage(cache_file)
        return cast(Compiled, dispatcher)

    return compiled


def _tolerate_damage(cache_file: Any) -> None:
    """Compile anew where the cache cannot be read, and go on where it cannot be written."""
    load, save = cache_file.load, cache_file.save

    def load_or_none(key: Any) -> Any:
        try:
            return load(key)
        except _DAMAGED:
            with suppress(OSError):
                cache_file.flush()
            return None

    def save_if_possible(key: Any, data: Any) -> None:
        try:
            save(key, data)
        except _DAMAGED as error:
            _say_uncached(f"{cache_file._cache_path} cannot be written to ({getattr(error, 'strerror', error)})")

    cache_file.load, cache_file.save = load_or_none, save_if_possible


@functools.cache
def _say_uncached(why: str) -> None:
    logger.warning(
        "compiled kernels cannot be kept: %s; each start compiles them again, which takes about a minute (set "
        "NUMBA_CACHE_DIR to a folder that can be written to)",
        why,
    )
