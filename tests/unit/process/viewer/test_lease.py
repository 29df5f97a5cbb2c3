from acquire.contract.messaging.messages import Status
from process.viewer.rig_client.lease import RENEW_NS, Lease


def held_by(name: str) -> Status:
    return Status(state="idle", control=name)


def test_while_nobody_holds_control_any_browser_may_act() -> None:
    assert Lease().refusal(held_by(""), 3, "scan") == ""
    assert Lease().refusal(None, 3, "scan") == ""


def test_another_browser_only_looks_and_reads_who_holds_control() -> None:
    lease = Lease()
    status = held_by(lease.name(0))
    assert lease.refusal(status, 0, "jog_hold") == ""
    assert lease.name(0) in lease.refusal(status, 1, "jog_hold")
    assert "anna on pts/3" in lease.refusal(held_by("anna on pts/3"), 0, "scan")


def test_a_stop_needs_no_control() -> None:
    assert Lease().refusal(held_by("anna"), 0, "stop") == ""


def test_a_restarted_page_does_not_inherit_what_another_held() -> None:
    assert Lease().name(0) != Lease().name(0)


def test_control_is_renewed_for_a_browser_that_is_there_and_for_no_other() -> None:
    lease = Lease()
    now_ns = 10 * RENEW_NS
    assert lease.renewal(held_by(lease.name(2)), [0, 1], now_ns) is None
    assert lease.renewal(held_by("anna"), [0, 1], now_ns) is None
    assert lease.renewal(held_by(lease.name(1)), [0, 1], now_ns) == 1
    assert lease.renewal(held_by(lease.name(1)), [0, 1], now_ns + RENEW_NS - 1) is None
    assert lease.renewal(held_by(lease.name(1)), [0, 1], now_ns + RENEW_NS) == 1
