# SPDX-License-Identifier: MIT
"""Chunks of lost workers: every scan is attempted or has failed, whatever is lost."""

from collections import Counter

from hypothesis import given
from hypothesis import strategies as st
from numbered_scans import scans_of

from salsanext_cli.runs.loop.cluster.chunk_queue import (
    MAX_LOSSES,
    MAX_LOST_NODES,
    MAX_SPARED,
    ChunkQueue,
)
from salsanext_cli.runs.loop.pool import chunks

SCANS = scans_of(("00", number) for number in range(12))


def test_chunks_are_sent_in_order_each_under_a_number():
    parts = chunks(SCANS, 1, 3)
    queue = ChunkQueue(parts)
    sent = [queue.send() for _ in parts]
    assert [chunk.scans for chunk in sent] == parts
    assert len({chunk.number for chunk in sent}) == len(parts)
    assert not any(chunk.is_alone for chunk in sent)
    assert not queue.is_waiting
    assert queue
    for chunk in sent:
        queue.finish(chunk.number)
    assert not queue


def test_the_chunk_of_a_lost_worker_is_sent_alone_and_then_its_scans_one_by_one():
    queue = ChunkQueue([tuple(SCANS[:2]), tuple(SCANS[2:])])
    for is_alone in (False, True):
        chunk = queue.send()
        assert (chunk.scans, chunk.is_alone) == (tuple(SCANS[:2]), is_alone)
        assert queue.lose(chunk.number) is None
    for scan in SCANS[:2]:
        for loss in range(1, MAX_LOSSES + 1):
            chunk = queue.send()
            assert (chunk.scans, chunk.is_alone) == ((scan,), True)
            assert queue.lose(chunk.number) == (scan if loss == MAX_LOSSES else None)
    assert queue.send().scans == tuple(SCANS[2:])


def test_the_scans_of_a_chunk_whose_node_is_lost_are_sent_each_to_a_node_of_its_own():
    queue = ChunkQueue([tuple(SCANS[:2])])
    assert not queue.send().owns_node
    queue.lose(1, node="a")
    chunk = queue.send()
    assert (chunk.is_alone, chunk.owns_node, chunk.lost_on) == (True, False, "a")
    queue.lose(chunk.number, is_node_lost=True, node="b")
    for scan in SCANS[:2]:
        chunk = queue.send()
        assert (chunk.scans, chunk.owns_node, chunk.lost_on) == ((scan,), True, "b")
        assert (chunk.losses, chunk.lost_nodes) == (0, 0)


def test_a_chunk_with_an_unexpected_exception_is_sent_again_once():
    queue = ChunkQueue([tuple(SCANS[:2]), tuple(SCANS[2:])])
    first = queue.send()
    assert queue.retry(first.number, "a")
    again = queue.send()
    assert (again.scans, again.is_alone, again.lost_on) == (first.scans, True, "a")
    assert not queue.retry(again.number, "b")
    assert queue.send().scans == tuple(SCANS[2:])


def test_a_scan_that_brings_its_nodes_down_fails():
    """Its chunk is sent in scans after some nodes; those of the other scans live."""
    deadly, harmless = SCANS[:2]
    queue = ChunkQueue([(deadly, harmless)])
    sent = Counter()
    failed = []
    while queue:
        chunk = queue.send()
        if deadly not in chunk.scans:
            queue.finish(chunk.number)
            continue
        sent[len(chunk.scans)] += 1
        failed.append(queue.lose(chunk.number, is_node_lost=True))
    assert sent == {2: 2, 1: MAX_LOST_NODES}
    assert failed[-1] == deadly
    assert set(failed[:-1]) == {None}


def test_a_chunk_that_was_not_started_waits_again_as_it_is():
    queue = ChunkQueue([tuple(SCANS[:2]), tuple(SCANS[2:])])
    for _ in range(MAX_SPARED):
        chunk = queue.send()
        assert (chunk.scans, chunk.is_alone) == (tuple(SCANS[:2]), False)
        assert queue.scans(chunk.number) == chunk.scans
        assert queue.spare(chunk.number, "a") is None


def test_a_scan_that_ends_its_worker_before_that_confirms_the_start_fails_at_last():
    queue = ChunkQueue([tuple(SCANS[:1])])
    failed = []
    while queue:
        failed.append(queue.spare(queue.send().number, "a"))
    # The first loss that counts lets it be alone.
    assert failed == [None] * (MAX_SPARED + MAX_LOSSES) + [SCANS[0]]


@given(st.sets(st.sampled_from(SCANS)), st.integers(1, 5), st.randoms(use_true_random=False))
def test_exactly_the_deadly_scans_fail(deadly, size, draw):
    """Workers have two chunks unless one is alone. Some die without a reason, with no chunk alone.

    A worker that dies has finished the first and started the second, or has not.
    """
    queue = ChunkQueue(chunks(SCANS, 1, size))
    done, failed, accidents = [], [], 3
    while queue:
        held = [queue.send()]
        if queue.is_waiting and not held[0].is_alone:
            held.append(queue.send())
        is_accident = accidents > 0 and not held[0].is_alone and draw.random() < 0.3
        accidents -= is_accident
        deaths = [index for index, chunk in enumerate(held) if deadly.intersection(chunk.scans)]
        if is_accident:
            deaths.append(draw.randrange(len(held)))
        if deaths:
            last = min(deaths)
            for chunk in reversed(held[last + 1 :]):
                assert queue.spare(chunk.number, "a") is None
            failed += filter(None, [queue.lose(held[last].number)])
            for chunk in held[:last]:
                queue.finish(chunk.number)
                done += chunk.scans
        else:
            for chunk in held:
                queue.finish(chunk.number)
                done += chunk.scans
    assert sorted(failed) == sorted(deadly)
    assert sorted([*done, *failed]) == SCANS
