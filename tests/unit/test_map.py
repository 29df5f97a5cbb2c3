"""The map and the recipes are true: what they name exists, every folder is on the map, diagrams equal the tables."""

from __future__ import annotations

import ast
import re

import pytest

from acquire.contract.states import TRANSITIONS as RIG
from acquire.sweep.phases import TRANSITIONS as SWEEP
from tests import ROOT

MAP = (ROOT / "docs/architecture.md").read_text()
TOP = ("acquire", "process", "tui", "firmware", "systemd", "tests", "docs")
_PLACE = re.compile(rf"`((?:{'|'.join(TOP)})/[\w./-]*)(?::(\w+))?`")
_EDGE = re.compile(r"^  (\w+) --> (\w+)(?:: (.+))?$", re.MULTILINE)


def places(document: str) -> list[tuple[str, str]]:
    """(path, function or empty) of everything of ours that a document names in backquotes."""
    return _PLACE.findall((ROOT / document).read_text())


def definitions(path: str) -> set[str]:
    tree = ast.parse((ROOT / path).read_text())
    return {
        node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
    }


def exists(path: str, name: str) -> bool:
    return (ROOT / path).exists() and (not name or name in definitions(path))


def diagram(heading: str) -> dict[str, dict[str, set[str]]]:
    """Edges of the first diagram behind a text: from -> to -> labels."""
    block = MAP.partition(heading)[2].partition("stateDiagram-v2")[2].partition("```")[0]
    found: dict[str, dict[str, set[str]]] = {}
    for start, end, labels in _EDGE.findall(block):
        found.setdefault(start, {})[end] = set(labels.split(", ")) - {""}
    return found


@pytest.mark.parametrize("document", ["docs/architecture.md", "CONTRIBUTING.md", "README.md", "docs/design.md"])
def test_everything_that_a_document_names_exists(document: str) -> None:
    found = places(document)
    assert found
    assert [place for place in found if not exists(*place)] == []


@pytest.mark.parametrize("package", ["acquire", "process", "tui"])
def test_every_folder_is_on_the_map(package: str) -> None:
    folders = {str(path.parent.relative_to(ROOT)) for path in (ROOT / package).rglob("*.py")} - {package}
    assert len(folders) > 5
    assert [folder for folder in sorted(folders) if f"`{folder}/`" not in MAP] == []


def test_the_diagram_of_the_rig_is_its_table() -> None:
    drawn = diagram("The rig (`acquire/contract/states.py`)")
    assert {start: set(ends) for start, ends in drawn.items()} == {
        state.name: {end.name for end in ends} for state, ends in RIG.items()
    }


def test_the_diagram_of_a_sweep_is_its_table() -> None:
    table: dict[str, dict[str, set[str]]] = {}
    for phase, row in SWEEP.items():
        for decision, end in row.items():
            words = decision.name.lower().replace("_", " ")
            table.setdefault(phase.name, {}).setdefault(end.name, set()).add(words)
    assert diagram("One sweep (`acquire/sweep/phases.py`)") == table


def test_a_place_that_is_not_there_would_be_noticed() -> None:
    assert not exists("acquire/nowhere.py", "")
    assert not exists("acquire/contract/states.py", "no_such_function")
