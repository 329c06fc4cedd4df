# SPDX-License-Identifier: MIT
"""Workers of a run on a cluster: as many as its nodes have room for, each with an open task.

A worker is started, gets a place on a node, and opens the task there. Another one is started for
one that fails to. A node that cannot open the task, or on which several starts fail, is excluded.
"""

import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import replace
from functools import partial
from typing import Any

from salsanext_cli.runs.loop.cluster.calls import Calls, call_after
from salsanext_cli.runs.loop.cluster.error_lines import cause_line
from salsanext_cli.runs.loop.cluster.members import Member
from salsanext_cli.runs.loop.cluster.messages import Assignment, Send, Waiting
from salsanext_cli.runs.loop.cluster.node_code import NodeProblem
from salsanext_cli.runs.loop.cluster.nodes import Nodes
from salsanext_cli.runs.loop.cluster.worker_size import Node, WorkerSize

MAX_FAILED_STARTS = 3  # Workers of a node that end while they open the task
OPEN_TIMEOUT_S = 600.0  # For a worker to open the task, which may compile a network
WAITING_AFTER_S = 15.0  # Without any worker
WORKERS_END_TIMEOUT_S = 2.0  # For workers to end, before their unfinished files are removed

START_HINT = "it may lack memory; Ray writes its logs to /tmp/ray/session_latest/logs"


class Crew:
    """Workers of a run.

    Parameters
    ----------
    nodes : Nodes
        Nodes of the cluster.
    assignment : Assignment
        Work of the workers.
    send : callable
        Sends a message to the main process.
    calls : SimpleQueue
        Calls that the main thread makes.
    on_open : callable
        Called when a worker has opened the task.
    on_end : callable
        Called when no node is left, after the message about it.
    """

    def __init__(
        self,
        nodes: Nodes,
        assignment: Assignment,
        send: Send,
        calls: Calls,
        *,
        on_open: Callable[[], None],
        on_end: Callable[[], None],
    ) -> None:
        self.nodes = nodes
        self.cluster = nodes.cluster
        self.assignment = assignment
        self.send = send
        self.calls = calls
        self.on_open = on_open
        self.on_end = on_end
        self.size = self._fitting_size(())
        self.members: list[Member] = []
        self.grows = True  # Whether more workers than there is room for wait for more nodes
        self.failed_starts: Counter[str] = Counter()  # By id of the node, "" where it is unknown
        self.idle_since: float | None = time.monotonic()  # None while any worker is open
        self.last_report = self.idle_since  # Time of the last report that no worker is open

    def fit_size(self, nodes: Sequence[Node]) -> None:
        """Replace the workers that wait for room if those of another size fit on the nodes."""
        size = self._fitting_size(nodes)
        if size == self.size:
            return
        self.size = size
        for member in [member for member in self.members if not member.node]:
            self.remove(member)

    def room(self, nodes: Sequence[Node]) -> int:
        """Return the number of workers that nodes have room for."""
        return sum(map(self.size.places, nodes))

    def open_members(self) -> list[Member]:
        """Return the workers that have opened the task."""
        return [member for member in self.members if member.is_open]

    def start_workers(self) -> None:
        """Start workers for which nodes have room, and some that wait for more nodes."""
        nodes = self.nodes.usable()
        if not self.open_members():
            self.fit_size(nodes)
        # Workers that wait for room let a cluster grow that can, each time to twice its size.
        spare = max(1, len(self.open_members())) if self.grows else 0
        target = min(self.assignment.scans, self.room(nodes) + spare)
        while len(self.members) < target:
            handle = self.cluster.start_worker(self.size, self.assignment.work, self.nodes.unusable)
            member = Member(handle=handle, nodes=frozenset(node.id for node in nodes))
            self.members.append(member)
            self.call(member, partial(self._started, member), "node")

    def end_late_starts(self) -> None:
        """End workers that have not opened the task in time."""
        now = time.monotonic()
        starting = [member for member in self.members if member.node and not member.is_open]
        for member in starting:
            # The end of one may exclude the node of others.
            if member in self.members and now - member.located_at > OPEN_TIMEOUT_S:
                self._fail_start(member, f"one was not ready within {OPEN_TIMEOUT_S:.0f} s")

    def report_waiting(self) -> None:
        """Report now and then that no worker is open."""
        now = time.monotonic()
        if (
            self.idle_since is None
            or now - max(self.idle_since, self.last_report) <= WAITING_AFTER_S
        ):
            return
        self.send(Waiting(seconds=now - self.idle_since, room=str(self.size)))
        self.last_report = now

    def exclude(self, node: str, problem: NodeProblem) -> None:
        """Exclude a node from the run, which ends without any other one.

        A run whose last node goes waits for the next, also if it has excluded one before.
        """
        for member in [member for member in self.members if member.node == node]:
            if not member.is_open:
                self.remove(member)
        report = self.nodes.report(node, problem)
        if node not in self.nodes.unusable:
            self.nodes.unusable.add(node)
            self.send(report)
        if self.room(self.nodes.usable()) or self.open_members():
            self.start_workers()
        else:
            self.send(replace(report, ends_run=True))
            self.on_end()

    def remove(self, member: Member) -> None:
        """End a worker, whose calls then have no effect."""
        self.members.remove(member)
        self.cluster.end(member.handle)
        if self.idle_since is None and not self.open_members():
            self.idle_since = time.monotonic()

    def end(self) -> None:
        """End all workers, and wait a little until they have ended."""
        running = [self.cluster.call(member.handle, "node") for member in self.open_members()]
        for member in self.members:
            self.cluster.end(member.handle)
        end = time.monotonic() + WORKERS_END_TIMEOUT_S
        for future in running:
            try:
                future.exception(max(0.0, end - time.monotonic()))
            except TimeoutError:
                return

    def call(
        self,
        member: Member,
        function: Callable[["Future[Any]"], None],
        method: str,
        *arguments: Any,
    ) -> None:
        """Call a method of a worker, and then a function with its result, in the main thread."""
        future = self.cluster.call(member.handle, method, *arguments)
        call_after(self.calls, future, function)

    def _fitting_size(self, nodes: Sequence[Node]) -> WorkerSize:
        return WorkerSize.fitting(
            nodes, uses_gpu=self.assignment.uses_gpu, memory=self.assignment.worker_memory
        )

    def _started(self, member: Member, located: "Future[str]") -> None:
        """Let a worker open the task."""
        if member not in self.members:
            return
        try:
            member.node = located.result()
        except self.cluster.LOSS_ERRORS as error:
            self._fail_start(member, cause_line(error))
            return
        if member.node in self.nodes.unusable:  # It was started before its node was excluded.
            self.remove(member)
            self.start_workers()
            return
        member.located_at = time.monotonic()
        self.call(member, partial(self._opened, member), "open", self.assignment.required)

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
            self.exclude(member.node, problem)
            return
        member.is_open = True
        self.idle_since = None
        for node in (member.node, ""):
            self.failed_starts.pop(node, None)
        self.on_open()

    def _fail_start(self, member: Member, problem: str) -> None:
        """Start another worker for one that ended before it could take chunks.

        After several on an unknown node, the run ends unless others work; the next start then waits
        for the next look at the nodes. A start on a node that is lost does not count, nor one on an
        unknown node if any is lost.
        """
        self.remove(member)
        places = {member.node} if member.node else member.nodes
        if places - self.nodes.listed():
            self.start_workers()
            return
        self.failed_starts[member.node] += 1
        failure = NodeProblem(text=f"ends workers while they start: {problem}", hint=START_HINT)
        if self.failed_starts[member.node] < MAX_FAILED_STARTS:
            self.start_workers()
        elif member.node:
            self.exclude(member.node, failure)
        elif not self.open_members():
            report = self.nodes.report("of the cluster", failure)
            self.send(replace(report, ends_run=True))
            self.on_end()
