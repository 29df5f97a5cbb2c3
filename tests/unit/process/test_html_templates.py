"""Names and words from outside must not become markup, in none of the pages."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import jinja2
import pytest

from process.calibration.report_page import quarter_circle_page
from process.html_templates import render
from process.viewer.rig_client.commands import CommandNote
from process.viewer.status_html import note_html, small_html

EVIL = "<script>alert('frog')</script>"
HARMLESS = "&lt;script&gt;"


@pytest.fixture
def template(tmp_path: Path) -> Path:
    path = tmp_path / "page.html"
    path.write_text('<p title="{{ name }}">{{ name }}</p>', encoding="utf-8")
    return path


def test_a_value_is_escaped_in_text_and_in_an_attribute(template: Path) -> None:
    assert render(template, name='"><b>') == '<p title="&#34;&gt;&lt;b&gt;">&#34;&gt;&lt;b&gt;</p>'


def test_a_value_that_was_forgotten_is_an_error_and_no_gap_in_the_page(template: Path) -> None:
    with pytest.raises(jinja2.UndefinedError, match="name"):
        render(template)


@pytest.mark.parametrize(
    "html",
    [
        pytest.param(quarter_circle_page(SimpleNamespace(patterns=[]), [EVIL], None), id="calibration"),
        pytest.param(note_html(CommandNote(EVIL, False, 0), 0), id="command note"),
        pytest.param(small_html(EVIL, strong=EVIL), id="small text"),
    ],
)
def test_words_from_outside_stay_words(html: str) -> None:
    assert HARMLESS in html
    assert "<script" not in html
