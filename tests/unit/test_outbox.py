"""When the worker looks at its fold to show it: often, but never at the cost of the fold."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import zmq

from acquire.contract.lanes import bind
from process import outbox as outbox_module
from process.outbox import BEHIND_FRAMES, PREVIEW_LEAST_NS, REST, REST_BEHIND, Outbox

COST_NS = PREVIEW_LEAST_NS


@pytest.fixture
def outbox(run_dir, monkeypatch):
    times = iter((0, COST_NS))
    monkeypatch.setattr(outbox_module, "time", SimpleNamespace(monotonic_ns=lambda: next(times)))
    context = zmq.Context()
    made = Outbox(bind(context, zmq.XPUB, run_dir, "results"))
    yield made
    made.socket.close(0)
    context.term()


@pytest.mark.parametrize(("lag", "rest"), [(0, REST), (BEHIND_FRAMES, REST), (BEHIND_FRAMES + 1, REST_BEHIND)])
def test_the_next_look_waits_in_proportion_to_the_last_and_longer_while_the_fold_is_behind(outbox, lag, rest):
    outbox.say_preview(SimpleNamespace(lag_frames=lag, preview=lambda: None))
    due_ns = COST_NS + rest * COST_NS
    assert not outbox.preview_due(due_ns - 1)
    assert outbox.preview_due(due_ns)
