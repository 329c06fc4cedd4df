# SPDX-License-Identifier: MIT
"""Chunks of a run on a cluster on their way to the workers, and their attempts on the way back.

The main thread makes all calls, which other threads put into a queue: for a message that has
arrived, and for a call of a worker that has ended.
"""

import time
from collections import Counter, deque
from concurrent.futures import Future
from functools import partial
from queue import Empty
from typing import Any

from salsanext_cli.runs.loop.cluster.calls import Calls
from salsanext_cli.runs.loop.cluster.crew import START_HINT, Crew
from salsanext_cli.runs.loop.cluster.losses import Losses
from salsanext_cli.runs.loop.cluster.members import Member, StartedChunk, idle_member
from salsanext_cli.runs.loop.cluster.messages import (
    Alive,
    Assignment,
    FinishedChunk,
    FreePlaces,
    Joined,
    LongChunk,
    LongChunks,
    PackedChunk,
    Send,
)
from salsanext_cli.runs.loop.cluster.node_code import NodeProblem
from salsanext_cli.runs.loop.cluster.nodes import NODE_INTERVAL_S, Nodes

LONG_CHUNK_S = 900.0
"""Time of a chunk after which the user is told: 16 scans with uncertainties take some minutes.

No worker counts as lost because it takes long. A sequence may take hours to fuse, and a file system
that hangs for hours would become the fault of the scans on it.
"""
MAX_LOSSES_OF_NODE = 4  # Workers that it loses without a finished chunk in between


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
        self.send = send
        self.calls = calls
        self.nodes = Nodes(cluster, assignment.required, send)
        self.crew = Crew(
            self.nodes, assignment, send, calls, on_open=self._hand_out, on_end=self.close
        )
        self.losses = Losses(self.nodes, send, calls)
        self.losses_of_node: Counter[str] = Counter()  # Since its last finished chunk, by id
        self.chunks: deque[PackedChunk] = deque()  # For which no worker has a place
        self.alone: deque[PackedChunk] = deque()  # For which no worker is idle
        self.requested = 0  # Number of chunks that were asked for and have not arrived
        self.last_look = 0.0
        self.has_begun = False  # Whether workers may run
        self.is_closed = False

    def begin(self) -> bool:
        """Check all nodes with room for workers; return whether the run can begin."""
        nodes = self.nodes.usable()
        self.crew.fit_size(nodes)
        with_room = [node for node in nodes if self.crew.room([node])]
        if not self.nodes.begin(with_room):
            return False
        usable = [node for node in with_room if node.id not in self.nodes.unusable]
        self.has_begun = True
        gpus = 0 if self.crew.size.gpus else sum(node.gpus for node in nodes)
        workers = self.crew.room(usable)
        self.send(Joined(nodes=len(usable), workers=workers, unused_gpus=gpus))
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
        self._request(-1)
        (self.alone if chunk.is_alone else self.chunks).append(chunk)
        self._hand_out()

    def end(self) -> None:
        """End all workers."""
        self.crew.end()

    def _look_at_nodes(self) -> None:
        """Start workers for which nodes have room now, and report what takes long."""
        now = time.monotonic()
        if now - self.last_look < NODE_INTERVAL_S:
            return
        self.last_look = now
        self.losses.report_answered()
        self.crew.end_late_starts()
        self.crew.start_workers()
        self._hand_out()
        self._report_long_chunks()
        self.send(Alive())
        self.crew.report_waiting()

    def _request(self, count: int) -> None:
        """Note that so many more chunks are expected, or have arrived if it is negative."""
        self.requested += count
        self.crew.grows = not self.requested

    def _hand_out(self) -> None:
        """Give chunks to the workers that have fewest, and ask for as many as there are places.

        While a chunk waits for an idle worker, no other one is given, so that workers become idle.
        """
        members = self.crew.open_members()
        for chunk in [*self.alone]:
            idle = idle_member(members, chunk, self.nodes.name)
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
            self._request(missing)
            self.send(FreePlaces(count=missing))

    def _give(self, member: Member, chunk: PackedChunk) -> None:
        """Let a worker confirm that it starts a chunk, after those that it has, and attempt it."""
        number = chunk.number
        member.chunks.append(number)
        self.crew.call(member, partial(self._started, member, number), "process")
        attempted = partial(self._attempted, member, number)
        self.crew.call(member, attempted, "attempt", number, chunk.scans)

    def _started(self, member: Member, number: int, starting: "Future[int]") -> None:
        """Note that a worker has started a chunk."""
        if number not in member.chunks:
            return
        try:
            process = starting.result()
        except self.cluster.LOSS_ERRORS:
            self._lose(member)
            return
        member.started[number] = StartedChunk(since=time.monotonic(), process=process)

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
        member.started.pop(number, None)
        member.is_taken = member.owns_node = False
        self.losses_of_node.pop(member.node, None)
        name = self.nodes.name(member.node)
        self.send(FinishedChunk(number=number, attempts=attempts, node=name))
        self._hand_out()

    def _lose(self, member: Member, problem: NodeProblem | None = None) -> None:
        """Report the loss of a worker and of its chunks, and start another one.

        `problem`: what its node lacks, so that the worker must not go on.
        """
        self.losses.report(member, is_fault_of_node=problem is not None)
        member.chunks.clear()
        self.crew.remove(member)
        self.losses_of_node[member.node] += 1
        others = self.crew.open_members()
        is_fatal = self.losses_of_node[member.node] >= MAX_LOSSES_OF_NODE
        if is_fatal and any(other.node != member.node for other in others):
            problem = problem or NodeProblem(text="ends its workers", hint=START_HINT)
        if problem:
            self.crew.exclude(member.node, problem)
        else:
            self.crew.start_workers()

    def _report_long_chunks(self) -> None:
        """Report once each chunk that its worker has had for long: it may never end."""
        now = time.monotonic()
        reported: list[LongChunk] = []
        for member in self.crew.open_members():
            for number, started in member.started.items():
                seconds = now - started.since
                if started.is_reported or seconds <= LONG_CHUNK_S:
                    continue
                started.is_reported = True
                node = self.nodes.name(member.node)
                chunk = LongChunk(
                    number=number, node=node, process=started.process, seconds=seconds
                )
                reported.append(chunk)
        if reported:
            self.send(LongChunks(chunks=tuple(reported)))
