"""Compile numeric kernels with numba once, keep them on disk, and compile them again when any source changes."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

Compiled = TypeVar("Compiled", bound=Callable[..., Any])


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
    takes the place of the file's time stamp in the cache. Where no folder can be written (a locked-down service),
    kernels are compiled in each process.
    """
    options: dict[str, Any] = {"nogil": True, "inline": "always" if inline else "never"}

    def compiled(function: Compiled) -> Compiled:
        try:
            dispatcher: Any = njit(cache=True, **options)(function)
        except RuntimeError:
            return cast(Compiled, njit(**options)(function))
        cache_file = dispatcher._cache._cache_file
        cache_file._source_stamp = digest
        # Numba compares its version before it unpickles the rest of an index. With the digest in it, an old index is
        # not unpickled at all: the types that a kernel takes may have been renamed since.
        cache_file._version = f"{cache_file._version} {digest.hex()}"
        return cast(Compiled, dispatcher)

    return compiled
