"""Standard streams of any encoding: a character that one cannot show is replaced, and never ends a command."""

from __future__ import annotations

import codecs
import io
import os
import sys
import unicodedata
from pathlib import Path
from typing import Any, Final, TextIO

from .ascii_signs import ASCII_SIGNS

LINES: Final = "sweepscope-lines"
"""Error handler for printed lines: our signs in ASCII, all else as an escape that shows what stood there."""
CELLS: Final = "sweepscope-cells"
"""Error handler for a drawn screen: every character keeps its width."""
_PLAIN_ASCII: Final = "sweepscope_ascii"


def prepare_streams() -> None:
    """Make stdin, stdout and stderr take any character; once, at the program's start.

    One that is closed becomes /dev/null: the next file that is opened must not take its number.
    """
    _open_missing()
    codecs.register_error(LINES, lambda error: _replaced(error, _as_escape))
    codecs.register_error(CELLS, lambda error: _replaced(error, _as_wide))
    codecs.register(_plain_ascii)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # click writes UTF-8 to a stream whose encoding is called "ascii"
            plain = codecs.lookup(stream.encoding).name == "ascii"
            stream.reconfigure(encoding=_PLAIN_ASCII if plain else None, errors=LINES)
    if isinstance(sys.stdin, io.TextIOWrapper):
        sys.stdin.reconfigure(errors="surrogateescape")


def _open_missing() -> None:
    while (fd := os.open(os.devnull, os.O_RDWR)) <= 2:
        pass
    os.close(fd)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115 - open until the end


def keep_widths(stream: TextIO) -> None:
    """Replace what ``stream`` cannot show by as many cells: a screen is drawn on it."""
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors=CELLS)


def draws_signs(stream: TextIO) -> bool:
    """True if the stream's encoding has all of our signs."""
    try:
        "".join(map(chr, ASCII_SIGNS)).encode(stream.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _replaced(error: UnicodeError, one: Any) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(one, error.object[error.start : error.end])), error.end


def _as_escape(sign: str) -> str:
    r"""``\xff`` also for a byte of a file name that is not UTF-8, which Python holds as a lone surrogate."""
    code = ord(sign)
    if code in ASCII_SIGNS:
        return str(ASCII_SIGNS[code])
    return f"\\x{code - 0xDC00:02x}" if 0xDC80 <= code <= 0xDCFF else sign.encode("ascii", "backslashreplace").decode()


def _as_wide(sign: str) -> str:
    code = ord(sign)
    if code in ASCII_SIGNS:
        return str(ASCII_SIGNS[code])
    if unicodedata.combining(sign):
        return ""
    return "??" if unicodedata.east_asian_width(sign) in ("W", "F") else "?"


def _plain_ascii(name: str) -> codecs.CodecInfo | None:
    if name != _PLAIN_ASCII:
        return None
    ascii_codec = codecs.lookup("ascii")
    return codecs.CodecInfo(
        ascii_codec.encode,
        ascii_codec.decode,
        incrementalencoder=ascii_codec.incrementalencoder,
        incrementaldecoder=ascii_codec.incrementaldecoder,
        name=name,
    )
