"""The ledger pairs triggers with frames and never guesses."""

from __future__ import annotations

from acquire.lockstep import Ledger

MS = 1_000_000


def fire(ledger: Ledger, frame_index: int, at_ms: int, attempt: int = 0) -> None:
    ledger.triggered(
        frame_index=frame_index,
        attempt=attempt,
        trigger_id=100 + frame_index,
        position_steps=3 * frame_index,
        position_um=9.525 * frame_index,
        trigger_cycles=0,
        at_mono_ns=at_ms * MS,
        deadline_ns=(at_ms + 100) * MS,
    )


def armed() -> Ledger:
    ledger = Ledger()
    ledger.arm(1000 * MS)
    return ledger


def test_a_frame_belongs_to_the_trigger_before_it():
    ledger = armed()
    fire(ledger, 0, 1010)
    pairing = ledger.frame(7, 1010 * MS)
    assert pairing.shot is not None and pairing.shot.frame_index == 0
    assert pairing.lost == ()


def test_a_frame_that_nobody_triggered_is_counted_and_dropped():
    ledger = armed()
    assert ledger.frame(7, 1010 * MS).shot is None
    assert ledger.extra_frames == 1


def test_a_jump_of_the_ids_names_the_trigger_whose_frame_was_lost():
    ledger = armed()
    fire(ledger, 0, 1010)
    ledger.frame(7, 1010 * MS)
    fire(ledger, 1, 1020)
    fire(ledger, 2, 1030)
    pairing = ledger.frame(9, 1030 * MS)
    assert [shot.frame_index for shot in pairing.lost] == [1]
    assert pairing.shot is not None and pairing.shot.frame_index == 2


def test_a_repeated_frame_is_not_taken_twice():
    ledger = armed()
    fire(ledger, 0, 1010)
    ledger.frame(7, 1010 * MS)
    fire(ledger, 1, 1020)
    assert ledger.frame(7, 1020 * MS).shot is None
    pairing = ledger.frame(8, 1020 * MS)
    assert pairing.shot is not None and pairing.shot.frame_index == 1


def test_an_exposure_from_before_the_trigger_is_not_its_frame():
    ledger = armed()
    fire(ledger, 0, 1050)
    assert ledger.frame(7, 1020 * MS).shot is None


def test_an_exposure_from_before_the_arming_is_stale():
    ledger = armed()
    fire(ledger, 0, 1001)
    assert ledger.frame(7, 900 * MS).shot is None
    assert len(ledger.pending) == 1


def test_an_extra_frame_between_two_triggers_does_not_shift_the_pairs():
    ledger = armed()
    fire(ledger, 0, 1010)
    ledger.frame(7, 1010 * MS)
    assert ledger.frame(8, 1015 * MS).shot is None
    fire(ledger, 1, 1020)
    pairing = ledger.frame(9, 1020 * MS)
    assert pairing.shot is not None and pairing.shot.frame_index == 1


def test_a_trigger_without_a_frame_is_lost_after_its_deadline():
    ledger = armed()
    fire(ledger, 0, 1010)
    assert ledger.overdue(1100 * MS) == ()
    assert [shot.frame_index for shot in ledger.overdue(1110 * MS)] == [0]
    assert not ledger.pending


def test_giving_up_returns_all_that_was_awaited():
    ledger = armed()
    fire(ledger, 4, 1010)
    assert [shot.frame_index for shot in ledger.drop_all()] == [4]
