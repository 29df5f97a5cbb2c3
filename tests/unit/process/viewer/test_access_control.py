from http import HTTPStatus

import pytest

from process.viewer.server.access_control import PASS, AccessControl, PageRequest, is_loopback


@pytest.fixture
def access() -> AccessControl:
    access = AccessControl()
    access.arm()
    return access


def visit(access: AccessControl, **changes: object) -> PageRequest:
    fields = {
        "target": "/",
        "hosts": ("127.0.0.1:8080",),
        "origins": ("http://127.0.0.1:8080",),
        "cookies": (access.cookie,),
        "upgrade": True,
    }
    return PageRequest(**(fields | changes))


def test_the_own_page_with_its_cookie_passes(access: AccessControl) -> None:
    assert access.decide(visit(access)) is PASS


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1", "[::1]:8080", "LOCALHOST:1"])
def test_any_port_of_a_loopback_name_passes_because_ssh_maps_ports(access: AccessControl, host: str) -> None:
    assert access.decide(visit(access, hosts=(host,), origins=(f"http://{host}",))).passes


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1.evil.example", "192.168.1.7:8080", "localhost.evil.example", "", "a@127.0.0.1", "x:y"],
)
def test_a_name_that_is_not_loopback_is_refused_even_with_the_cookie(access: AccessControl, host: str) -> None:
    assert access.decide(visit(access, hosts=(host,), origins=(f"http://{host}",))).status == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize(
    "origin",
    ["https://evil.example", "null", "http://127.0.0.1:9999", "http://localhost:8080", "file://", "127.0.0.1:8080"],
)
def test_an_origin_other_than_the_host_is_refused_even_with_the_cookie(access: AccessControl, origin: str) -> None:
    assert access.decide(visit(access, origins=(origin,))).status == HTTPStatus.FORBIDDEN


def test_a_websocket_that_does_not_say_where_it_comes_from_is_refused(access: AccessControl) -> None:
    assert access.decide(visit(access, origins=())).status == HTTPStatus.FORBIDDEN


def test_headers_that_come_twice_are_refused(access: AccessControl) -> None:
    assert access.decide(visit(access, hosts=("localhost", "localhost"))).status == HTTPStatus.FORBIDDEN
    own = "http://127.0.0.1:8080"
    assert access.decide(visit(access, origins=(own, own))).status == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize("cookies", [(), ("",), ("sweepscope=1",), ("a=b; c=d",)])
def test_without_the_cookie_nobody_comes_in(access: AccessControl, cookies: tuple[str, ...]) -> None:
    assert access.decide(visit(access, cookies=cookies)).status == HTTPStatus.UNAUTHORIZED


def test_the_cookie_of_another_page_does_not_open_this_one(access: AccessControl) -> None:
    assert access.decide(visit(access, cookies=(AccessControl().cookie,))).status == HTTPStatus.UNAUTHORIZED


def test_the_cookie_is_found_among_others(access: AccessControl) -> None:
    assert access.decide(visit(access, cookies=(f"a=b; {access.cookie}; c=d",))).passes


def test_the_token_is_exchanged_for_a_strict_cookie_and_leaves_the_address(access: AccessControl) -> None:
    verdict = access.decide(visit(access, target=f"/?token={access.token}", origins=(), cookies=(), upgrade=False))
    assert (verdict.status, verdict.location) == (HTTPStatus.FOUND, "/")
    assert verdict.cookie.startswith(access.cookie)
    assert {"HttpOnly", "SameSite=Strict", "Path=/"} <= set(verdict.cookie.split("; "))
    assert access.token not in verdict.cookie


@pytest.mark.parametrize("target", ["/?token=wrong", "/?token=", "/?token=%00"])
def test_a_wrong_token_gets_no_cookie(access: AccessControl, target: str) -> None:
    verdict = access.decide(visit(access, target=target, origins=(), cookies=(), upgrade=False))
    assert (verdict.status, verdict.cookie) == (HTTPStatus.UNAUTHORIZED, "")


def test_a_foreign_page_cannot_exchange_a_token(access: AccessControl) -> None:
    stolen = visit(
        access, target=f"/?token={access.token}", origins=("https://evil.example",), cookies=(), upgrade=False
    )
    assert access.decide(stolen).status == HTTPStatus.FORBIDDEN


def test_query_parameters_never_reach_the_page_because_its_code_obeys_them(access: AccessControl) -> None:
    lure = visit(access, target="/?websocket=ws://evil.example", origins=(), upgrade=False)
    assert access.decide(lure).location == "/"


def test_before_the_page_is_complete_not_even_its_own_browser_comes_in() -> None:
    access = AccessControl()
    assert access.decide(visit(access)).status == HTTPStatus.SERVICE_UNAVAILABLE


def test_a_header_of_unreasonable_length_is_refused_and_counted(access: AccessControl) -> None:
    assert access.decide(visit(access, cookies=("x" * 5000,))).status == HTTPStatus.FORBIDDEN
    assert access.refused["size"] == 1


def test_a_page_bound_to_the_network_is_view_only_and_still_wants_the_cookie() -> None:
    access = AccessControl("0.0.0.0")
    access.arm()
    here = {"hosts": ("192.168.1.7:8080",), "origins": ("http://192.168.1.7:8080",)}
    assert access.view_only
    assert access.decide(visit(access, **here)).passes
    assert access.decide(visit(access, **here, cookies=())).status == HTTPStatus.UNAUTHORIZED
    named = visit(access, hosts=("evil.example",), origins=("http://evil.example",))
    assert access.decide(named).status == HTTPStatus.FORBIDDEN


@pytest.mark.parametrize(
    ("host", "expected"), [("localhost", True), ("127.0.0.9", True), ("::1", True), ("0.0.0.0", False), ("rig", False)]
)
def test_only_names_of_this_machine_alone_count_as_loopback(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected
