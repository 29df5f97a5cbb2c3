"""When the worker makes the next preview of its fold: often, but never at the cost of the fold."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
import zmq

from acquire.contract.messaging.lanes import bind
from process.worker.publisher import BEHIND_FRAMES, PREVIEW_BEHIND_NS, PREVIEW_NS, REST, REST_BEHIND, ResultPublisher

COST_NS = PREVIEW_NS
QUICK_NS = PREVIEW_NS // (2 * REST_BEHIND)


@pytest.fixture
def publisher(run_dir: Path) -> Iterator[ResultPublisher]:
    context: zmq.Context = zmq.Context()
    made = ResultPublisher(bind(context, zmq.XPUB, run_dir, "results"))
    yield made
    made.socket.close(0)
    context.term()


@pytest.mark.parametrize(
    ("lag", "cost_ns", "rest_ns"),
    [
        (0, COST_NS, REST * COST_NS),
        (BEHIND_FRAMES, COST_NS, REST * COST_NS),
        (BEHIND_FRAMES + 1, COST_NS, REST_BEHIND * COST_NS),
        (0, QUICK_NS, PREVIEW_NS),
        (BEHIND_FRAMES + 1, QUICK_NS, PREVIEW_BEHIND_NS),
    ],
)
def test_the_next_preview_waits_in_proportion_to_the_last_and_longer_while_the_fold_is_behind(
    publisher, lag, cost_ns, rest_ns
):
    publisher.preview_made(0, cost_ns)
    assert not publisher.preview_due(cost_ns + rest_ns - 1, lag)
    assert publisher.preview_due(cost_ns + rest_ns, lag)


def test_a_fold_that_has_caught_up_is_shown_without_the_rest_of_one_that_is_behind(publisher):
    publisher.preview_made(0, QUICK_NS)
    now_ns = QUICK_NS + PREVIEW_NS
    assert not publisher.preview_due(now_ns, BEHIND_FRAMES + 1)
    assert publisher.preview_due(now_ns, 0)
