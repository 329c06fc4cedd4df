# SPDX-License-Identifier: MIT
"""Workers that the driver starts, and chunks that they get, on a cluster that only counts."""

from collections import deque
from concurrent.futures import Future
from itertools import takewhile
from queue import SimpleQueue

import pytest

from salsanext_cli.runs.loop.cluster import crew as crew_module
from salsanext_cli.runs.loop.cluster import driver as driver_module
from salsanext_cli.runs.loop.cluster import nodes as nodes_module
from salsanext_cli.runs.loop.cluster.crew import MAX_FAILED_STARTS
from salsanext_cli.runs.loop.cluster.driver import LONG_CHUNK_S, MAX_LOSSES_OF_NODE, Driver
from salsanext_cli.runs.loop.cluster.messages import (
    Alive,
    Assignment,
    FinishedChunk,
    FreePlaces,
    Joined,
    LongChunk,
    LongChunks,
    LostWorker,
    PackedChunk,
    UnusableNode,
    Waiting,
)
from salsanext_cli.runs.loop.cluster.node_code import NodeProblem, NodeRequirements
from salsanext_cli.runs.loop.cluster.worker_size import Node

REQUIRED = NodeRequirements(versions={})
GIB = 2**30
PROCESS = 4711
LACK = NodeProblem(text="cannot read /a", hint="mount it")
NO_WEIGHTS = NodeProblem(text="cannot begin: no weights")


class LossError(Exception):
    """Loss of a worker."""


def node(number, cores):
    return Node(id=f"id{number}", name=f"node{number}", cores=cores, gpus=0, memory=64 * GIB)


class RaisedError(LossError):
    """Exception of the code of a call."""


class NodeError(LossError):
    """Loss of a node."""


class CountingCluster:
    """Cluster whose calls end when the test says so."""

    LOSS_ERRORS = (LossError,)
    RAISED_ERRORS = (RaisedError,)
    NODE_ERRORS = (NodeError,)

    def __init__(self, *cores):
        self.all = [node(number, count) for number, count in enumerate(cores)]
        self.problems = {}
        self.without = []
        self.sizes = []
        self.started = 0
        self.ended = set()
        self.pending = deque()  # Method, worker, arguments and future of each call

    def nodes(self):
        return self.all

    def check(self, checked, required):
        assert required is REQUIRED
        future = Future()
        problem = self.problems.get(checked)
        if isinstance(problem, Exception):
            future.set_exception(problem)
        else:
            future.set_result(problem)
        return future

    def start_worker(self, size, work, without):
        assert work == b"work"
        self.sizes.append(size.cores)
        self.without.append(set(without))
        self.started += 1
        return self.started

    def call(self, worker, method, *arguments):
        future = Future()
        self.pending.append((method, worker, arguments, future))
        return future

    def end(self, worker):
        self.ended.add(worker)


class Room:
    """A driver on such a cluster, and what it has sent."""

    def __init__(self, *cores, scans=100):
        self.cluster = CountingCluster(*cores)
        self.sent = []
        self.calls = SimpleQueue()
        assignment = Assignment(
            address="auto", work=b"work", required=REQUIRED, scans=scans, worker_memory=GIB
        )
        self.driver = Driver(self.cluster, assignment, self.sent.append, self.calls)

    def start(self, *nodes):
        """Start workers, the first of them on nodes, where they open the task."""
        self.driver._look_at_nodes()
        for node in nodes:
            self.answer("node", node)
            self.answer("open", None)

    def answer(self, method, result, worker=None):
        """End the first call of a method, by its result or by an error.

        A worker that answers for a chunk has confirmed its start before.
        """
        call = next(c for c in self.cluster.pending if c[0] == method and worker in (None, c[1]))
        while method == "attempt" and self.confirms(call):
            self.answer("process", PROCESS, call[1])
        self.cluster.pending.remove(call)
        if isinstance(result, Exception):
            call[3].set_exception(result)
        else:
            call[3].set_result(result)
        self.make_calls()
        return call[1]

    def confirms(self, call):
        """Return whether a confirmation of the same worker comes before a call."""
        earlier = takewhile(lambda other: other is not call, self.cluster.pending)
        return any(other[:2] == ("process", call[1]) for other in earlier)

    def make_calls(self):
        while not self.calls.empty():
            self.calls.get()()

    def take(self, *numbers):
        for number in numbers:
            self.driver.take(PackedChunk(number=number, scans=b"scans"))

    def running(self):
        return [(c[1], c[2][0]) for c in self.cluster.pending if c[0] == "attempt"]

    def sent_of(self, kind):
        return [message for message in self.sent if isinstance(message, kind)]


def test_the_run_begins_when_all_nodes_have_what_it_needs():
    room = Room(8, 0, 4)
    assert room.driver.begin()
    assert room.sent == [Joined(nodes=2, workers=3)]


def test_the_run_does_not_begin_if_a_node_lacks_something():
    room = Room(8, 4)
    room.cluster.problems["id1"] = LACK
    assert not room.driver.begin()
    assert room.sent == [
        UnusableNode(node="node1", problem=LACK.text, hint="mount it", ends_run=True)
    ]


def test_a_check_that_raises_is_a_problem_of_its_node_and_a_node_that_went_is_none():
    room = Room(4, 4)
    room.cluster.problems["id0"] = LossError()
    assert room.driver.begin()
    room.cluster.problems["id1"] = RaisedError("ray::check()\nImportError: no module")
    assert not room.driver.begin()
    assert room.sent[-1].problem == "cannot be checked: ImportError: no module"
    assert room.sent[-1].ends_run


def test_a_node_that_does_not_answer_is_skipped(monkeypatch):
    monkeypatch.setattr(nodes_module, "CHECK_TIMEOUT_S", 0.0)
    room = Room(4, 4)
    check = room.cluster.check
    room.cluster.check = lambda node, required: Future() if node == "id0" else check(node, required)
    assert room.driver.begin()
    assert room.sent_of(UnusableNode)[0].node == "node0"
    assert room.sent[-1] == Joined(nodes=1, workers=1)
    room.cluster.check = lambda node, required: Future()
    room.driver.nodes.unusable.clear()
    assert not room.driver.begin()
    assert [message.ends_run for message in room.sent_of(UnusableNode)] == [False, False, True]


def test_workers_fit_on_smaller_nodes_that_come_when_all_others_have_gone(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(4)
    room.start("id0")
    room.take(1, 2)
    room.cluster.all = [node(1, 2)]
    room.answer("attempt", LossError())
    room.start()
    assert room.cluster.sizes[-1] == 2


def test_nodes_without_room_for_a_worker_need_nothing():
    room = Room(4, 0)
    room.cluster.problems["id1"] = LACK
    assert room.driver.begin()


def test_each_worker_has_two_chunks_and_gets_the_next_when_one_ends():
    room = Room(4, 4)
    room.start("id0", "id1")
    assert sum(message.count for message in room.sent_of(FreePlaces)) == 4
    room.take(1, 2, 3, 4)
    assert sorted(room.running()) == [(1, 1), (1, 3), (2, 2), (2, 4)]
    room.answer("attempt", b"attempts", worker=2)
    finished = FinishedChunk(number=2, attempts=b"attempts", node="node1")
    assert room.sent[-2:] == [finished, FreePlaces(count=1)]
    room.take(5)
    assert (2, 5) in room.running()


def test_the_chunks_of_a_lost_worker_are_named_and_another_one_starts():
    room = Room(4, 4)
    room.start("id0", "id1")
    room.take(1, 2, 3, 4)
    started = room.cluster.started
    room.answer("attempt", LossError(), worker=1)
    assert room.sent[-1] == LostWorker(node="node0", chunks=(1,), spared=(3,))
    assert 1 in room.cluster.ended
    assert room.cluster.started == started + 1
    # The call of the second chunk fails too.
    room.answer("attempt", LossError(), worker=1)
    assert len(room.sent_of(LostWorker)) == 1
    # The chunks come again, and wait until there is a place.
    room.take(5, 6)
    assert sorted(room.running()) == [(2, 2), (2, 4)]
    room.answer("attempt", b"", worker=2)
    assert sorted(room.running()) == [(2, 4), (2, 5)]


def test_a_chunk_that_is_sent_alone_waits_for_an_idle_worker():
    room = Room(4, 4)
    room.start("id0", "id1")
    room.take(1, 2, 3)
    for number in (4, 5):
        room.driver.take(PackedChunk(number=number, scans=b"scans", is_alone=True))
    room.driver.take(PackedChunk(number=6, scans=b"scans"))
    # The first worker has two chunks and gets no other one; the second becomes idle.
    room.answer("attempt", b"", worker=1)
    assert sorted(room.running()) == [(1, 3), (2, 2)]
    room.answer("attempt", b"", worker=2)
    assert sorted(room.running()) == [(1, 3), (2, 4)]
    room.answer("attempt", b"", worker=2)
    # No chunk waits to be alone: the other worker has a place for the last.
    assert sorted(room.running()) == [(1, 3), (1, 6), (2, 5)]
    room.answer("attempt", b"", worker=2)
    # For the six chunks, and for two places that are free now.
    assert sum(message.count for message in room.sent_of(FreePlaces)) == 6 + 2


@pytest.mark.parametrize(
    ("answer", "is_node_lost"),
    [
        (None, False),
        (LACK, False),
        (RaisedError(), False),
        (LossError("no memory for the check"), False),
        (NodeError(), True),
        ("gone", True),
    ],
)
def test_a_chunk_that_is_alone_is_lost_with_its_worker_or_with_the_node(answer, is_node_lost):
    room = Room(4)
    room.start("id0")
    room.driver.take(PackedChunk(number=1, scans=b"scans", is_alone=True))
    if answer == "gone":
        room.cluster.all = []
        answer = LossError()
    room.cluster.problems["id0"] = answer
    room.answer("attempt", LossError())
    (lost,) = room.sent_of(LostWorker)
    assert lost == LostWorker(node="node0", chunks=(1,), is_node_lost=is_node_lost)


def test_a_node_that_does_not_answer_in_time_is_lost(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(driver_module.time, "monotonic", lambda: now[0])
    room = Room(4)
    now[0] = 10.0
    room.start("id0")
    room.driver.take(PackedChunk(number=1, scans=b"scans", is_alone=True))
    room.cluster.check = lambda node, required: Future()
    room.answer("attempt", LossError())
    room.cluster.all = []
    for now[0], count in ((30.0, 0), (80.0, 1)):
        room.start()
        assert len(room.sent_of(LostWorker)) == count
    assert room.sent_of(LostWorker)[0].is_node_lost


def test_a_lost_chunk_goes_to_another_node_and_one_that_owns_a_node_is_there_alone():
    room = Room(8, 4)
    room.start("id0", "id0", "id1")
    alone = {"scans": b"scans", "is_alone": True}
    room.driver.take(PackedChunk(number=1, **alone, lost_on="node0"))
    assert room.running() == [(3, 1)]
    room.driver.take(PackedChunk(number=2, **alone, lost_on="node1", owns_node=True))
    room.driver.take(PackedChunk(number=3, **alone))
    room.driver.take(PackedChunk(number=4, **alone, owns_node=True))
    # The second worker of the first node gets nothing beside the chunk that owns it.
    assert room.running() == [(3, 1), (1, 2)]
    room.answer("attempt", b"", worker=1)
    # The third chunk is alone on it now, and the fourth waits for a whole node.
    assert room.running() == [(3, 1), (1, 3)]
    room.answer("attempt", b"", worker=3)
    assert room.running() == [(1, 3), (3, 4)]


def test_a_chunk_returns_to_the_node_that_lost_it_if_there_is_no_other(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(4, 4)
    room.start("id0", "id1")
    for number in (1, 2):
        room.driver.take(PackedChunk(number=number, scans=b"", is_alone=True, lost_on="node0"))
    assert room.running() == [(2, 1)]
    del room.cluster.all[1]
    room.answer("attempt", LossError(), worker=2)
    room.start()
    assert room.running() == [(1, 2)]


def test_a_node_that_lacks_something_after_a_failure_is_left_out_with_its_chunks():
    room = Room(4, 4)
    room.start("id0", "id1")
    room.take(1, 2, 3, 4)
    room.answer("attempt", LACK, worker=1)
    assert room.sent_of(LostWorker) == [LostWorker(node="node0", spared=(1, 3), is_node_lost=True)]
    assert room.sent[-1] == UnusableNode(node="node0", problem=LACK.text, hint=LACK.hint)
    assert room.driver.nodes.unusable == {"id0"}
    room.answer("attempt", LACK, worker=2)
    assert room.sent[-1].ends_run


def test_a_node_that_ends_worker_after_worker_is_left_out_if_others_work(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    for finishes, lost in ((False, True), (True, False)):
        room = Room(4, 4)
        room.start("id1", "id0")
        for number in range(1, MAX_LOSSES_OF_NODE + 1):
            # Either worker has one.
            room.take(2 * number - 1, 2 * number)
            worker = max(worker for worker, _ in room.running())
            if finishes and number == 2:
                room.answer("attempt", b"", worker=worker)
                room.take(100)
            room.answer("attempt", LossError(), worker=worker)
            if not room.sent_of(UnusableNode):
                room.start()
                room.answer("node", "id0")
                room.answer("open", None)
        assert [message.node for message in room.sent_of(UnusableNode)] == ["node0"] * lost
        assert not room.driver.is_closed


@pytest.mark.parametrize("located", [True, False])
def test_workers_that_are_lost_with_their_node_while_they_start_are_no_fault(located):
    room = Room(4)
    room.start()
    for number in range(MAX_FAILED_STARTS + 1):
        if located:
            room.answer("node", f"id{number}")
        room.cluster.all = [node(number + 1, 4)]
        room.answer("open" if located else "node", LossError("killed"))
    assert not room.driver.is_closed
    assert not room.driver.crew.failed_starts


def test_a_worker_that_is_not_ready_in_time_is_replaced(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(driver_module.time, "monotonic", lambda: now[0])
    room = Room(4)
    for now[0] in (10.0, 620.0, 1230.0):
        assert not room.driver.is_closed
        room.start()
        room.answer("node", "id0")
    assert room.cluster.ended == {1, 2}
    # Another one on the node, which is left out with the first.
    room.answer("node", "id0")
    now[0] = 1900.0
    room.start()
    assert room.driver.is_closed
    assert "not ready within 600 s" in room.sent_of(UnusableNode)[-1].problem


def test_workers_start_where_there_is_room_and_more_when_nodes_come(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(8)
    room.start()
    # One more waits for room, so that a cluster grows that can.
    assert room.cluster.started == 2 + 1
    room.start("id0", "id0")
    room.take(1, 2, 3, 4)
    room.start()
    assert room.cluster.started == 2 + 2
    room.cluster.all = [*room.cluster.all, node(1, 8)]
    room.start()
    assert room.cluster.started == 4 + 2


def test_no_more_workers_start_than_there_are_scans_or_chunks(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(40, scans=3)
    room.start()
    assert room.cluster.started == 3
    room = Room(4)
    room.start("id0")
    assert room.driver.requested == 2
    room.start()
    assert room.cluster.started == 1 + 1


def test_a_node_that_cannot_open_the_task_is_left_out_and_the_run_goes_on():
    room = Room(4, 4)
    room.start("id0")
    room.take(1, 2)
    room.answer("node", "id1")
    room.answer("open", NO_WEIGHTS)
    assert room.sent[-1] == UnusableNode(node="node1", problem="cannot begin: no weights")
    assert not room.driver.is_closed
    # Another worker that was started before opens nothing; the next starts elsewhere.
    count = len(room.sent)
    worker = room.answer("node", "id1")
    assert worker in room.cluster.ended
    assert len(room.sent) == count
    assert room.cluster.without[-1] == {"id1"}


def test_the_run_ends_when_no_node_is_left():
    room = Room(4)
    room.start()
    room.answer("node", "id0")
    room.answer("open", NO_WEIGHTS)
    assert room.sent[-1] == UnusableNode(
        node="node0", problem="cannot begin: no weights", ends_run=True
    )
    assert room.driver.is_closed


@pytest.mark.parametrize("located", [True, False])
def test_a_node_whose_workers_end_while_they_start_is_left_out(located):
    room = Room(4)
    room.start()
    for _ in range(MAX_FAILED_STARTS):
        assert not room.driver.is_closed
        if located:
            room.answer("node", "id0")
            room.answer("open", LossError("killed"))
        else:
            room.answer("node", LossError("killed"))
    assert room.driver.is_closed
    assert room.sent[-1].ends_run
    assert "killed" in room.sent[-1].problem


def test_starts_that_fail_on_an_unknown_node_do_not_end_a_run_with_workers(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(4)
    room.start("id0")
    room.take(1, 2)
    for _ in range(MAX_FAILED_STARTS + 1):
        room.answer("node", LossError("killed"))
        room.start()  # The next start waits for a look at the nodes at the latest.
    assert not room.driver.is_closed
    # A worker that opens the task makes those before it forgotten.
    room.cluster.all = [node(0, 8)]
    room.start("id0")
    assert not room.driver.crew.failed_starts


def test_a_run_whose_last_node_goes_waits_for_the_next(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(4, 4)
    room.start("id0")
    room.take(1)
    room.answer("node", "id1")
    room.answer("open", NO_WEIGHTS)
    room.cluster.all = room.cluster.all[1:]
    room.answer("attempt", LossError(), worker=1)
    room.start()
    assert not room.driver.is_closed
    room.cluster.all = [*room.cluster.all, node(2, 4)]
    room.start("id2")
    assert room.driver.crew.open_members()


def test_workers_that_wait_for_room_get_the_size_of_the_first_node(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room()
    room.start()
    assert room.cluster.sizes == [4]
    room.cluster.all = [node(0, 2)]
    room.start()
    assert room.cluster.sizes == [4, 2, 2]
    assert room.cluster.ended == {1}
    room.answer("node", LossError("ended"), worker=1)
    room.answer("node", "id0", worker=2)
    room.answer("open", None, worker=2)
    # The size is that of all workers from now on.
    room.cluster.all = [node(0, 2), node(1, 1)]
    room.start()
    assert set(room.cluster.sizes[1:]) == {2}


def test_a_run_that_waits_longer_says_so(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(driver_module.time, "monotonic", lambda: now[0])
    room = Room()
    for now[0] in (10.0, 16.0, 20.0, 32.0):
        room.start()
    assert [message.seconds for message in room.sent_of(Waiting)] == [16.0, 32.0]


def test_a_run_without_workers_says_that_it_waits(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    monkeypatch.setattr(crew_module, "WAITING_AFTER_S", 0.0)
    room = Room()
    room.start()
    assert room.sent_of(Waiting)
    room.cluster.all = [node(0, 4)]
    room.start("id0")
    count = len(room.sent_of(Waiting))
    room.start()
    assert len(room.sent_of(Waiting)) == count


def test_a_worker_that_dies_before_it_starts_a_chunk_is_no_fault_of_the_chunk():
    room = Room(4)
    room.start("id0")
    room.driver.take(PackedChunk(number=1, scans=b"scans", is_alone=True))
    # The node does not answer, and need not.
    room.cluster.check = lambda node, required: Future()
    room.answer("process", LossError())
    assert room.sent_of(LostWorker) == [LostWorker(node="node0", spared=(1,))]


def test_a_chunk_that_takes_long_is_reported_once_with_its_process(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(driver_module.time, "monotonic", lambda: now[0])
    room = Room(4, 4)
    now[0] = 10.0
    room.start("id0", "id1")
    room.take(1, 2, 3, 4)
    now[0] = 100.0
    room.answer("process", PROCESS, worker=2)
    # The other worker has started nothing; the second chunk of this one waits.
    for now[0] in (LONG_CHUNK_S, LONG_CHUNK_S + 101.0, LONG_CHUNK_S + 200.0):
        room.start()
    seconds = LONG_CHUNK_S + 1.0
    chunk = LongChunk(number=2, node="node1", process=PROCESS, seconds=seconds)
    assert room.sent_of(LongChunks) == [LongChunks(chunks=(chunk,))]
    # It is still its worker that attempts it.
    room.answer("attempt", b"attempts", worker=2)
    assert room.sent_of(FinishedChunk) == [
        FinishedChunk(number=2, attempts=b"attempts", node="node1")
    ]
    assert not room.sent_of(LostWorker)


def test_the_driver_is_alive_while_it_waits_for_the_checks_of_nodes(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(nodes_module.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(nodes_module, "wait", lambda _, seconds: now.append(now.pop() + seconds))
    room = Room(4)
    room.cluster.check = lambda node, required: Future()
    assert not room.driver.begin()
    assert len(room.sent_of(Alive)) == nodes_module.CHECK_TIMEOUT_S / nodes_module.NODE_INTERVAL_S
    assert room.sent[-1].ends_run


def test_all_workers_of_a_lost_node_are_lost_with_it(monkeypatch):
    monkeypatch.setattr(driver_module, "NODE_INTERVAL_S", 0.0)
    room = Room(8, 4)
    room.start("id0", "id0", "id1")
    for number in (1, 2):
        room.driver.take(PackedChunk(number=number, scans=b"scans", is_alone=True))
    room.cluster.all = [node(1, 4)]
    room.cluster.problems["id0"] = NodeError()
    for worker in (1, 2):
        room.answer("attempt", LossError(), worker=worker)
    assert room.sent_of(LostWorker) == [
        LostWorker(node="node0", chunks=(number,), is_node_lost=True) for number in (1, 2)
    ]
    # The third worker goes on, and no node is excluded.
    room.start()
    assert [member.node for member in room.driver.crew.open_members()] == ["id1"]
    assert not room.driver.nodes.unusable
