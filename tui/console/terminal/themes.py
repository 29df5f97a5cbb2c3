"""The console's colours: dark, light and high contrast; nothing is said by colour alone."""

from __future__ import annotations

from textual.theme import Theme

THEMES: tuple[Theme, ...] = (
    Theme(
        name="sweepscope-dark",
        primary="#4a90d9",
        secondary="#6a7f99",
        accent="#f0b429",
        success="#56b4a9",
        warning="#f0b429",
        error="#b3261e",
        background="#10141a",
        surface="#171d26",
        panel="#1f2833",
        foreground="#dde3ea",
        dark=True,
    ),
    Theme(
        name="sweepscope-light",
        primary="#1f5fa8",
        secondary="#56657a",
        accent="#9a5b00",
        success="#00705f",
        warning="#8a5200",
        error="#b3261e",
        background="#fbfaf7",
        surface="#f1efe9",
        panel="#e4e1d8",
        foreground="#1b1f24",
        dark=False,
    ),
    Theme(
        name="sweepscope-contrast",
        primary="#ffffff",
        secondary="#ffffff",
        accent="#ffff00",
        success="#00ff00",
        warning="#ffff00",
        error="#d00000",
        background="#000000",
        surface="#000000",
        panel="#000000",
        foreground="#ffffff",
        dark=True,
    ),
)
