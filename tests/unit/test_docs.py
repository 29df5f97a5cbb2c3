"""What the documents say of tests is true: every test that they name exists."""

from __future__ import annotations

import re

import pytest

from tests import ROOT

_FILE = re.compile(r"`((?:tests/[\w/]*)?test_\w+\.py)`")
_CLAIM = re.compile(r"`((?:tests/[\w/]*)?test_\w+\.py)`: ([^|`]+)")


def functions(name: str) -> list[str]:
    return re.findall(r"^def (test_\w+)", (ROOT / name).read_text(), re.MULTILINE)


def claims(text: str) -> list[tuple[str, str]]:
    """(file, words of one test) of each place that names tests by their words."""
    return [
        (name, re.sub(r"[^a-z0-9]+", "_", words.lower().partition("(")[0].replace("'", "")).strip("_"))
        for name, listed in _CLAIM.findall(text)
        for words in listed.split(";")
        if words.strip(" ,")
    ]


@pytest.mark.parametrize("document", ["README.md", "docs/security.md", "docs/faults.md", "docs/compatibility.md"])
def test_every_file_of_tests_that_a_document_names_is_there(document: str) -> None:
    named = _FILE.findall((ROOT / document).read_text())
    assert [name for name in named if not (ROOT / name).is_file()] == []


def test_every_test_that_the_threat_model_names_exists() -> None:
    found = claims((ROOT / "docs/security.md").read_text())
    assert len(found) >= 15
    assert [claim for claim in found if not any(claim[1] in name for name in functions(claim[0]))] == []


def test_every_row_of_the_threat_model_names_a_test() -> None:
    rows = [line for line in (ROOT / "docs/security.md").read_text().splitlines() if line.startswith("| ")]
    assert len(rows) >= 12
    assert [row for row in rows[1:] if not row.startswith("| ---") and not _FILE.search(row)] == []


def test_a_test_that_is_not_there_would_be_noticed() -> None:
    (name, words), *_ = claims("| x | `tests/unit/test_docs.py`: nothing of this name; |")
    assert not any(words in function for function in functions(name))
