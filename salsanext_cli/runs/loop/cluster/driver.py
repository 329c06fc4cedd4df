# SPDX-License-Identifier: MIT
"""Workers of a run on a cluster, and the chunks that they get.

The main thread makes all calls, which other threads put into a queue: for a message that has
arrived, and for a call of a worker that has ended.
"""

import time
from collections import Counter, deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from queue import Empty, SimpleQueue
from typing import Any

from salsanext_cli.runs.loop.cluster.error_lines import cause_line
from salsanext_cli.runs.loop.cluster.members import Member, SuspectedLoss, idle_member
from salsanext_cli.runs.loop.cluster.messages import (
    Alive,
    Assignment,
    FinishedChunk,
    FreePlaces,
    Joined,
    LostWorker,
    PackedChunk,
    UnusableNode,
    Waiting,
)
from salsanext_cli.runs.loop.cluster.node_code import VERSIONS_HINT, NodeProblem
from salsanext_cli.runs.loop.cluster.worker_size import Node, WorkerSize

CHECK_TIMEOUT_S = 60.0  # For the checks of all nodes
MAX_LOSSES_OF_NODE = 4  # Workers that it loses without a finished chunk in between
MAX_FAILED_STARTS = 3  # Workers of a node that end while they open the task
NODE_INTERVAL_S = 2.0  # Between looks at the nodes
OPEN_TIMEOUT_S = 600.0  # For a worker to open the task, which may compile a network
WAITING_AFTER_S = 15.0  # Without any worker
WORKERS_END_TIMEOUT_S = 2.0  # For workers to end, before their unfinished files are removed

CHECK_HINT = "see the state of the cluster with: ray status"
START_HINT = "it may lack memory; Ray writes its logs to /tmp/ray/session_latest/logs"

Send = Callable[[object], None]
Calls = SimpleQueue[Callable[[], None]]


class Driver:
    """Workers of a run on a cluster, which is joined before `begin`.

    Parameters
    ----------
    cluster : module
        `ray_cluster`, or what stands for it.
    assignment : Assignment
        Work of the workers.
    send : callable
        Sends a message to the main process.
    calls : SimpleQueue
        Calls that the main thread makes.
    """

    def __init__(self, cluster: Any, assignment: Assignment, send: Send, calls: Calls) -> None:
        self.cluster = cluster
        self.assignment = assignment
        self.send = send
        self.calls = calls
        self.size = self._fitting_size(())
        self.names: dict[str, str] = {}  # Of nodes, by id
        self.members: list[Member] = []
        self.losses: list[SuspectedLoss] = []
        self.chunks: deque[PackedChunk] = deque()  # For which no worker has a place
        self.alone: deque[PackedChunk] = deque()  # For which no worker is idle
        self.requested = 0  # Number of chunks that were asked for and have not arrived
        self.failed_starts: Counter[str] = Counter()  # By id of the node, "" where it is unknown
        self.losses_of_node: Counter[str] = Counter()  # Since its last finished chunk, by id
        self.unusable: set[str] = set()  # Ids of nodes
        self.last_look = 0.0
        self.idle_since: float | None = time.monotonic()  # None while any worker is open
        self.last_report = self.idle_since  # Time of the last report that no worker is open
        self.has_begun = False  # Whether workers may run
        self.is_closed = False

    def begin(self) -> bool:
        """Check all nodes with room for workers; return whether the run can begin."""
        nodes = self._nodes()
        self.size = self._fitting_size(nodes)
        usable = [node for node in nodes if self.size.places(node)]
        required = self.assignment.required
        checks = {node: self.cluster.check(node.id, required) for node in usable}
        end = time.monotonic() + CHECK_TIMEOUT_S
        for node, checked in checks.items():
            try:
                problem = checked.result(max(0.0, end - time.monotonic()))
            except TimeoutError:
                text = f"did not answer within {CHECK_TIMEOUT_S:.0f} s"
                problem = NodeProblem(text=text, hint=CHECK_HINT)
                self.unusable.add(node.id)
                if len(self.unusable) < len(usable):
                    self.send(self._report(node.id, problem))
                    continue
            except self.cluster.RAISED_ERRORS as error:
                text = f"cannot be checked: {cause_line(error)}"
                problem = NodeProblem(text=text, hint=VERSIONS_HINT)
            except self.cluster.LOSS_ERRORS:
                continue  # The node has gone; a worker on one that comes back checks it.
            if problem:
                report = self._report(node.id, problem)
                self.send(replace(report, ends_run=True))
                return False
        usable = [node for node in usable if node.id not in self.unusable]
        places = sum(map(self.size.places, usable))
        self.has_begun = True
        gpus = 0 if self.size.gpus else sum(node.gpus for node in nodes)
        self.send(Joined(nodes=len(usable), workers=places, unused_gpus=gpus))
        return True

    def run(self) -> None:
        """Make calls until the main process needs no more."""
        while not self.is_closed:
            self._look_at_nodes()
            try:
                call = self.calls.get(timeout=NODE_INTERVAL_S)
            except Empty:
                continue
            call()

    def close(self) -> None:
        """End the run, from the next call on."""
        self.is_closed = True

    def take(self, chunk: PackedChunk) -> None:
        """Take a chunk to attempt."""
        self.requested -= 1
        (self.alone if chunk.is_alone else self.chunks).append(chunk)
        self._hand_out()

    def end(self) -> None:
        """End all workers, and wait a little until they have ended."""
        running = [self._call(member, "node") for member in self.members if member.is_open]
        for member in self.members:
            self.cluster.end(member.handle)
        end = time.monotonic() + WORKERS_END_TIMEOUT_S
        for future in running:
            try:
                future.exception(max(0.0, end - time.monotonic()))
            except TimeoutError:
                return

    def _nodes(self) -> list[Node]:
        """Return the live nodes that are usable."""
        nodes = [node for node in self.cluster.nodes() if node.id not in self.unusable]
        self.names.update((node.id, node.name) for node in nodes)
        return nodes

    def _listed(self) -> frozenset[str]:
        """Return the ids of the live nodes."""
        return frozenset(node.id for node in self.cluster.nodes())

    def _name(self, node: str) -> str:
        """Return the name of a node by its id, also of one that is no more."""
        return self.names.get(node, node)

    def _report(self, node: str, problem: NodeProblem) -> UnusableNode:
        return UnusableNode(
            node=self._name(node), problem=problem.text, hint=problem.hint, trace=problem.trace
        )

    def _look_at_nodes(self) -> None:
        """Start workers for which nodes have room, and some that wait for more nodes."""
        now = time.monotonic()
        if now - self.last_look < NODE_INTERVAL_S:
            return
        self.last_look = now
        self._report_losses()
        self._end_late_starts()
        self._start_workers()
        self._hand_out()
        self.send(Alive())
        if self.idle_since is None:
            return
        if now - max(self.idle_since, self.last_report) > WAITING_AFTER_S:
            self.send(Waiting(seconds=now - self.idle_since, room=str(self.size)))
            self.last_report = now

    def _fitting_size(self, nodes: Sequence[Node]) -> WorkerSize:
        return WorkerSize.fitting(nodes, uses_gpu=self.assignment.uses_gpu)

    def _fit_size(self, nodes: Sequence[Node]) -> None:
        """Replace the workers that wait for room if those of another size fit on the nodes."""
        size = self._fitting_size(nodes)
        if size == self.size:
            return
        self.size = size
        for member in [member for member in self.members if not member.node]:
            self._remove(member)

    def _start_workers(self) -> None:
        nodes = self._nodes()
        if not self._open_members():
            self._fit_size(nodes)
        places = sum(map(self.size.places, nodes))
        # Workers that wait for room let a cluster grow that can, each time to twice its size.
        spare = 0 if self.requested else max(1, len(self._open_members()))
        target = min(self.assignment.scans, places + spare)
        while len(self.members) < target:
            handle = self.cluster.start_worker(self.size, self.assignment.work, self.unusable)
            member = Member(handle=handle, nodes=frozenset(node.id for node in nodes))
            self.members.append(member)
            self._then(self._call(member, "node"), partial(self._started, member))

    def _started(self, member: Member, located: Future[str]) -> None:
        """Let a worker open the task."""
        if member not in self.members:
            return
        try:
            member.node = located.result()
        except self.cluster.LOSS_ERRORS as error:
            self._fail_start(member, cause_line(error))
            return
        if member.node in self.unusable:  # It was started before its node was excluded.
            self._remove(member)
            self._start_workers()
            return
        member.located_at = time.monotonic()
        opening = self._call(member, "open", self.assignment.required)
        self._then(opening, partial(self._opened, member))

    def _opened(self, member: Member, opening: "Future[NodeProblem | None]") -> None:
        """Let a worker take chunks, or exclude its node."""
        if member not in self.members:
            return
        try:
            problem = opening.result()
        except self.cluster.LOSS_ERRORS as error:
            self._fail_start(member, cause_line(error))
            return
        if problem:
            self._exclude(member.node, problem)
            return
        member.is_open = True
        self.idle_since = None
        for node in (member.node, ""):
            self.failed_starts.pop(node, None)
        self._hand_out()

    def _fail_start(self, member: Member, problem: str) -> None:
        """Start another worker for one that ended before it could take chunks.

        After several on an unknown node, the run ends unless others work; the next start then waits
        for the next look at the nodes. A start on a node that is lost does not count, nor one on an
        unknown node if any is lost.
        """
        self._remove(member)
        places = {member.node} if member.node else member.nodes
        if places - self._listed():
            self._start_workers()
            return
        self.failed_starts[member.node] += 1
        failure = NodeProblem(text=f"ends workers while they start: {problem}", hint=START_HINT)
        if self.failed_starts[member.node] < MAX_FAILED_STARTS:
            self._start_workers()
        elif member.node:
            self._exclude(member.node, failure)
        elif not self._open_members():
            report = self._report("of the cluster", failure)
            self.send(replace(report, ends_run=True))
            self.close()

    def _end_late_starts(self) -> None:
        """End workers that have not opened the task in time."""
        now = time.monotonic()
        starting = [member for member in self.members if member.node and not member.is_open]
        for member in starting:
            # The end of one may exclude the node of others.
            if member in self.members and now - member.located_at > OPEN_TIMEOUT_S:
                self._fail_start(member, f"one was not ready within {OPEN_TIMEOUT_S:.0f} s")

    def _exclude(self, node: str, problem: NodeProblem) -> None:
        """Exclude a node from the run, which ends without any other one.

        A run whose last node goes waits for the next, also if it has excluded one before.
        """
        for member in [member for member in self.members if member.node == node]:
            if not member.is_open:
                self._remove(member)
        report = self._report(node, problem)
        if node not in self.unusable:
            self.unusable.add(node)
            self.send(report)
        has_room = any(map(self.size.places, self._nodes()))
        if has_room or self._open_members():
            self._start_workers()
        else:
            self.send(replace(report, ends_run=True))
            self.close()

    def _hand_out(self) -> None:
        """Give chunks to the workers that have fewest, and ask for as many as there are places.

        While a chunk waits for an idle worker, no other one is given, so that workers become idle.
        """
        members = self._open_members()
        for chunk in [*self.alone]:
            idle = idle_member(members, chunk, self._name)
            if idle:
                self.alone.remove(chunk)
                idle.is_taken = True
                idle.owns_node = chunk.owns_node
                self._give(idle, chunk)
        if self.alone:
            return
        while self.chunks and members:
            member = max(members, key=lambda member: member.places)
            if not member.places:
                return
            self._give(member, self.chunks.popleft())
        missing = sum(member.places for member in members) - self.requested
        if missing > 0:
            self.requested += missing
            self.send(FreePlaces(count=missing))

    def _give(self, member: Member, chunk: PackedChunk) -> None:
        member.chunks.append(chunk.number)
        attempting = self._call(member, "attempt", chunk.number, chunk.scans)
        self._then(attempting, partial(self._attempted, member, chunk.number))

    def _attempted(
        self, member: Member, number: int, attempting: "Future[bytes | NodeProblem]"
    ) -> None:
        """Pass on the attempts of a chunk, or the loss of its worker."""
        if number not in member.chunks:
            return  # The loss of its worker was noticed by another call.
        try:
            attempts = attempting.result()
        except self.cluster.LOSS_ERRORS:
            self._lose(member)
            return
        if not isinstance(attempts, bytes):
            self._lose(member, attempts)
            return
        member.chunks.remove(number)
        member.is_taken = member.owns_node = False
        self.losses_of_node.pop(member.node, None)
        self.send(FinishedChunk(number=number, attempts=attempts, node=self._name(member.node)))
        self._hand_out()

    def _lose(self, member: Member, problem: NodeProblem | None = None) -> None:
        """Report the loss of a worker and of its chunks, and start another one.

        `problem`: what its node lacks, so that the worker must not go on.
        """
        chunks = tuple(member.chunks)
        member.chunks.clear()
        self._remove(member)
        self.losses_of_node[member.node] += 1
        if problem:
            name = self._name(member.node)
            self.send(LostWorker(node=name, chunks=chunks, is_node_lost=True))
        elif member.is_taken:
            end = time.monotonic() + CHECK_TIMEOUT_S
            answer = self.cluster.check(member.node, self.assignment.required)
            loss = SuspectedLoss(node=member.node, chunks=chunks, answer=answer, end=end)
            self.losses.append(loss)
            self._then(answer, lambda _: self._report_losses())
        else:
            self.send(LostWorker(node=self._name(member.node), chunks=chunks))
        others = self._open_members()
        if not others:
            self.idle_since = time.monotonic()
        is_fatal = self.losses_of_node[member.node] >= MAX_LOSSES_OF_NODE
        if is_fatal and any(other.node != member.node for other in others):
            problem = problem or NodeProblem(text="ends its workers", hint=START_HINT)
        if problem:
            self._exclude(member.node, problem)
        else:
            self._start_workers()

    def _report_losses(self) -> None:
        """Report the losses whose nodes have answered, or had the time to."""
        now = time.monotonic()
        for loss in [loss for loss in self.losses if loss.answer.done() or now > loss.end]:
            self.losses.remove(loss)
            name = self._name(loss.node)
            is_lost = loss.is_node_lost(self.cluster, self._listed())
            self.send(LostWorker(node=name, chunks=loss.chunks, is_node_lost=is_lost))

    def _remove(self, member: Member) -> None:
        self.members.remove(member)
        self.cluster.end(member.handle)

    def _open_members(self) -> list[Member]:
        return [member for member in self.members if member.is_open]

    def _call(self, member: Member, method: str, *arguments: Any) -> "Future[Any]":
        return self.cluster.call(member.handle, method, *arguments)

    def _then(self, future: "Future[Any]", function: Callable[["Future[Any]"], None]) -> None:
        """Let the main thread call a function with a future when that is done."""
        future.add_done_callback(lambda done: self.calls.put(partial(function, done)))
