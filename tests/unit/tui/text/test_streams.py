"""What is printed to a stream that cannot show it."""

from __future__ import annotations

import io
import sys

import pytest

from tui.text.streams import draws_signs, keep_widths, prepare_streams

BAD_NAME = b"bad\xff".decode("utf-8", "surrogateescape")


@pytest.fixture
def stream(monkeypatch: pytest.MonkeyPatch):
    """Replace stdout by a stream of an encoding; returns it and its bytes."""

    def replaced(encoding: str) -> tuple[io.TextIOWrapper, io.BytesIO]:
        raw = io.BytesIO()
        text = io.TextIOWrapper(raw, encoding=encoding, write_through=True)
        monkeypatch.setattr(sys, "stdout", text)
        prepare_streams()
        return text, raw

    return replaced


@pytest.mark.parametrize("encoding", ["ascii", "iso8859-1", "cp1252", "koi8-r", "cp437"])
def test_our_signs_become_ascii_where_the_encoding_lacks_them(stream, encoding):
    text, raw = stream(encoding)
    print("\u25d0 \u2713 \u25b8 \u2026", file=text)
    shown = raw.getvalue().decode(encoding if encoding != "ascii" else "ascii")
    assert "\\u" not in shown and len(shown) == 8
    assert not draws_signs(text)


@pytest.mark.parametrize("encoding", ["ascii", "iso8859-1", "utf-8"])
def test_a_byte_of_a_name_that_is_not_utf8_is_shown_as_an_escape(stream, encoding):
    text, raw = stream(encoding)
    print(BAD_NAME, file=text)
    assert raw.getvalue() == b"bad\\xff\n"


def test_letters_that_the_encoding_has_stay_and_others_are_escaped(stream):
    text, raw = stream("iso8859-1")
    print("f\u00fcr \u4e2d", file=text)
    assert raw.getvalue() == b"f\xfcr \\u4e2d\n"


def test_click_prints_ascii_to_an_ascii_stream(stream):
    import click

    _, raw = stream("ascii")
    click.echo("caf\u00e9 \u2502")
    assert raw.getvalue() == b"caf\\xe9 |\n"


def test_on_a_drawn_screen_every_character_keeps_its_width(stream):
    text, raw = stream("ascii")
    keep_widths(text)
    print("\u2502\u4e2d\u00e9e\u0301" + BAD_NAME, file=text)
    assert raw.getvalue() == b"|???ebad?\n"


def test_utf8_draws_all_signs(stream):
    text, _ = stream("utf-8")
    assert draws_signs(text)
