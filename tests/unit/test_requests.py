"""Commands: what is understood, and what is refused with a way out."""

from __future__ import annotations

import pytest

from acquire.contract.errors import CommandRefusedError
from acquire.requests import REQUESTS, JogRequest, ScanRequest, parse_request


def test_arguments_become_typed_structs():
    assert parse_request("jog", {"steps": -10}) == JogRequest(-10)
    assert parse_request("scan", {"name": "stapes", "first_steps": 3}) == ScanRequest("stapes", 3)


def test_an_unknown_command_is_refused_with_the_nearest_one():
    with pytest.raises(CommandRefusedError, match="'resume'"):
        parse_request("resum", {})


@pytest.mark.parametrize(
    ("name", "args"),
    [
        ("scan", {"nmae": "x"}),
        ("scan", {"name": ""}),
        ("scan", {"steps_per_frame": 0}),
        ("jog", {}),
        ("jog", {"steps": 10**9}),
        ("goto", {"position_steps": "far"}),
        ("pause", {"now": True}),
    ],
)
def test_arguments_that_do_not_fit_are_refused_by_name(name, args):
    with pytest.raises(CommandRefusedError, match=name):
        parse_request(name, args)


def test_every_command_has_a_method_at_the_desk():
    from acquire.desk import Desk

    assert all(callable(getattr(Desk, f"_{name}")) for name in REQUESTS)
