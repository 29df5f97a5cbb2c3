"""When the worker looks at its fold to show it: often, but never at the cost of the fold."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import zmq

from acquire.contract.messaging.lanes import bind
from process.worker import publisher as outbox_module
from process.worker.publisher import BEHIND_FRAMES, PREVIEW_BEHIND_NS, PREVIEW_LEAST_NS, REST, REST_BEHIND, Outbox

COST_NS = PREVIEW_LEAST_NS
QUICK_NS = PREVIEW_LEAST_NS // (2 * REST_BEHIND)


@pytest.fixture
def outbox(run_dir):
    context = zmq.Context()
    made = Outbox(bind(context, zmq.XPUB, run_dir, "results"))
    yield made
    made.socket.close(0)
    context.term()


def look(outbox, monkeypatch, cost_ns):
    """A preview that takes so long, from 0 on."""
    times = iter((0, cost_ns))
    monkeypatch.setattr(outbox_module, "time", SimpleNamespace(monotonic_ns=lambda: next(times)))
    outbox.say_preview(SimpleNamespace(preview=lambda: None))


@pytest.mark.parametrize(
    ("lag", "cost_ns", "rest_ns"),
    [
        (0, COST_NS, REST * COST_NS),
        (BEHIND_FRAMES, COST_NS, REST * COST_NS),
        (BEHIND_FRAMES + 1, COST_NS, REST_BEHIND * COST_NS),
        (0, QUICK_NS, PREVIEW_LEAST_NS),
        (BEHIND_FRAMES + 1, QUICK_NS, PREVIEW_BEHIND_NS),
    ],
)
def test_the_next_look_waits_in_proportion_to_the_last_and_longer_while_the_fold_is_behind(
    outbox, monkeypatch, lag, cost_ns, rest_ns
):
    look(outbox, monkeypatch, cost_ns)
    assert not outbox.preview_due(cost_ns + rest_ns - 1, lag)
    assert outbox.preview_due(cost_ns + rest_ns, lag)


def test_a_fold_that_has_caught_up_is_looked_at_without_the_rest_of_one_that_is_behind(outbox, monkeypatch):
    look(outbox, monkeypatch, QUICK_NS)
    now_ns = QUICK_NS + PREVIEW_LEAST_NS
    assert not outbox.preview_due(now_ns, BEHIND_FRAMES + 1)
    assert outbox.preview_due(now_ns, 0)
