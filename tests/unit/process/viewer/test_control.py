from acquire.contract.messaging.messages import Status
from process.viewer.rig_client.control import RENEW_NS, BrowserControl


def held_by(name: str) -> Status:
    return Status(state="idle", control=name)


def test_while_no_client_holds_control_any_browser_may_act() -> None:
    assert BrowserControl().refusal(held_by(""), 3, "scan") == ""
    assert BrowserControl().refusal(None, 3, "scan") == ""


def test_another_browser_only_looks_and_reads_who_holds_control() -> None:
    control = BrowserControl()
    status = held_by(control.name(0))
    assert control.refusal(status, 0, "jog_hold") == ""
    assert control.name(0) in control.refusal(status, 1, "jog_hold")
    assert "anna on pts/3" in control.refusal(held_by("anna on pts/3"), 0, "scan")


def test_a_stop_needs_no_control() -> None:
    assert BrowserControl().refusal(held_by("anna"), 0, "stop") == ""


def test_a_restarted_page_does_not_inherit_what_another_held() -> None:
    assert BrowserControl().name(0) != BrowserControl().name(0)


def test_control_is_renewed_for_a_browser_that_is_there_and_for_no_other() -> None:
    control = BrowserControl()
    now_ns = 10 * RENEW_NS
    assert control.renewal(held_by(control.name(2)), [0, 1], now_ns) is None
    assert control.renewal(held_by("anna"), [0, 1], now_ns) is None
    assert control.renewal(held_by(control.name(1)), [0, 1], now_ns) == 1
    assert control.renewal(held_by(control.name(1)), [0, 1], now_ns + RENEW_NS - 1) is None
    assert control.renewal(held_by(control.name(1)), [0, 1], now_ns + RENEW_NS) == 1
