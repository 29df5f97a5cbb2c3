"""Our signs in plain ASCII, for ``--ascii`` and streams that cannot show them: one character for each; pure."""

from __future__ import annotations

from typing import TYPE_CHECKING

from acquire.contract.states import SIGNS

if TYPE_CHECKING:
    from rich.text import Text

ASCII_SIGNS = str.maketrans(
    {
        **dict(zip("▁▂▃▄▅▆▇█░▒▓", "_.-~=+*#.+*", strict=True)),  # bars and shades
        **{sign.glyph: sign.ascii_glyph for sign in SIGNS.values()},
        **dict(zip("✓◐·▸─│…↑↓←→", "v~.>-|.^v<>", strict=True)),
    }
)


def to_ascii(text: Text) -> Text:
    """``text`` with our signs replaced; what the operator typed stays as it is."""
    found = text.copy()
    found.plain = text.plain.translate(ASCII_SIGNS)
    return found
