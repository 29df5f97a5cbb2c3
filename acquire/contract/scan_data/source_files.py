"""The picture files that an imported scan was made of: names, sizes and checksums, as the scan file keeps them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from acquire.contract.errors import ScanFileError

from .dataset_names import SOURCES

_FIELDS = ("folder", "pattern", "numbers", "depth")


@dataclass(frozen=True)
class SourceFile:
    """The file of one frame; of a missing frame all is empty."""

    name: bytes = b""
    """As the file system has it: mostly, but not always, UTF-8."""
    size_bytes: int = 0
    sha256: str = ""
    """Of the whole file, in hex."""
    page: int = 0
    """In the file, counted from 0."""

    @property
    def text(self) -> str:
        r"""The name for people; other bytes than those of UTF-8 as ``\xff``."""
        return self.name.decode("utf-8", "backslashreplace")


@dataclass(frozen=True)
class Sources:
    """Where the frames of an imported scan come from."""

    folder: str
    """The folder, or the file of a stack."""
    pattern: str
    """Of the names."""
    numbers: str
    """What the numbers in the names say."""
    depth: str
    """What the values were taken for and why; empty where there was no question."""
    files: tuple[SourceFile, ...] = ()
    """By frame index."""

    def lines(self) -> list[str]:
        """For people."""
        there = [file for file in self.files if file.name]
        size = sum({file.name: file.size_bytes for file in there}.values())
        first = f"{there[0].text} to {there[-1].text}" if there else "nothing"
        lines = [f"imported from {self.folder}: {first} ({len({f.name for f in there})} files, {size} bytes)"]
        lines += [self.numbers] if self.numbers else []
        return [*lines, self.depth] if self.depth else lines

    def checksum_lines(self) -> list[bytes]:
        """As ``sha256sum --check`` reads them, one for each file."""
        once = {file.name: file for file in self.files if file.name}
        return [_checksum_line(file) for file in once.values()]


def _checksum_line(file: SourceFile) -> bytes:
    # as GNU coreutils escape names: a leading backslash says that the name is
    escaped = file.name.replace(b"\\", b"\\\\").replace(b"\n", b"\\n").replace(b"\r", b"\\r")
    return (b"" if escaped == file.name else b"\\") + file.sha256.encode() + b"  " + escaped


def write_sources(entry: h5py.Group, sources: Sources) -> None:
    """Create the group under /entry; nothing in it has a variable length."""
    group = entry.create_group(SOURCES)
    group.attrs["NX_class"] = np.bytes_("NXcollection")
    for name in _FIELDS:
        raw = getattr(sources, name).encode("utf-8", "backslashreplace")
        group.attrs[name] = np.array(raw, dtype=f"S{max(1, len(raw))}")
    widest = max((len(file.name) for file in sources.files), default=1) or 1
    group.create_dataset("name", data=np.array([file.name for file in sources.files], dtype=f"S{widest}"))
    group.create_dataset("size_bytes", data=np.array([file.size_bytes for file in sources.files], dtype="<i8"))
    group.create_dataset("sha256", data=np.array([file.sha256.encode() for file in sources.files], dtype="S64"))
    group.create_dataset("page", data=np.array([file.page for file in sources.files], dtype="<i4"))


def bytes_needed(sources: Sources) -> int:
    """Bytes in the scan file, rounded up."""
    widest = max((len(file.name) for file in sources.files), default=1)
    return len(sources.files) * (widest + 8 + 64 + 4) + 64 * 1024


def read_sources(scan_file: Path) -> Sources | None:
    """The sources of an imported scan; None where the file keeps none.

    Raises:
        ScanFileError: the file cannot be read.
    """
    try:
        with h5py.File(scan_file, "r", locking=False) as file:
            if SOURCES not in file["entry"]:
                return None
            group = file["entry"][SOURCES]
            texts = {name: bytes(group.attrs[name]).decode("utf-8", "replace") for name in _FIELDS}
            columns = (group[name][()] for name in ("name", "size_bytes", "sha256", "page"))
            files = tuple(
                SourceFile(bytes(name), int(size), bytes(digest).decode("ascii", "replace"), int(page))
                for name, size, digest, page in zip(*columns, strict=True)
            )
    except (OSError, KeyError, ValueError, RuntimeError, TypeError) as error:
        raise ScanFileError(f"{scan_file}: the names of its pictures cannot be read: {error}") from None
    return Sources(**texts, files=files)
