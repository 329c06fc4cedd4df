# SPDX-License-Identifier: MIT
"""Losses of workers, and whether their nodes were lost with them.

A worker that was lost is reported with its chunks: those that may have ended it, and those that it
had not started. If it had a chunk alone, that matters only if the node lives; the node is asked.
"""

import time
from collections.abc import Collection
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import Any

from salsanext_cli.runs.loop.cluster.calls import Calls, call_after
from salsanext_cli.runs.loop.cluster.members import Member
from salsanext_cli.runs.loop.cluster.messages import LostWorker, Send
from salsanext_cli.runs.loop.cluster.node_code import NodeProblem
from salsanext_cli.runs.loop.cluster.nodes import CHECK_TIMEOUT_S, Nodes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SuspectedLoss:
    """Loss of a worker with a chunk that was sent alone, until it is known whether its node lives.

    Attributes
    ----------
    node : str
        Id of the node.
    lost : LostWorker
        The report, as far as it is known.
    answer : Future
        Check of the node, which fails if the node is lost.
    end : float
        Time at which a node without an answer counts as lost.
    """

    node: str
    lost: LostWorker
    answer: "Future[NodeProblem | None]"
    end: float

    def is_node_lost(self, cluster: Any, listed: Collection[str]) -> bool:
        """Return whether the node is lost.

        A check has an answer, even a bad one, if it lives. It may also fail for a lack of memory.

        Parameters
        ----------
        cluster : module
            `ray_cluster`, or what stands for it.
        listed : collection of str
            Ids of the live nodes, as Ray lists them.
        """
        error = self.answer.exception() if self.answer.done() else None
        if isinstance(error, cluster.NODE_ERRORS):
            return True
        has_answer = self.answer.done() and error is None
        return not has_answer and self.node not in listed


class Losses:
    """Losses of the workers of a run.

    Parameters
    ----------
    nodes : Nodes
        Nodes of the cluster.
    send : callable
        Sends a message to the main process.
    calls : SimpleQueue
        Calls that the main thread makes.
    """

    def __init__(self, nodes: Nodes, send: Send, calls: Calls) -> None:
        self.nodes = nodes
        self.send = send
        self.calls = calls
        self._suspected: list[SuspectedLoss] = []

    def report(self, member: Member, *, is_fault_of_node: bool) -> None:
        """Report a worker that is lost, now or when it is known whether its node lives.

        Parameters
        ----------
        member : Member
            The worker, with its chunks.
        is_fault_of_node : bool
            Whether its node lacks something, which no chunk has caused.
        """
        started = () if is_fault_of_node else tuple(member.started)
        lost = LostWorker(
            node=self.nodes.name(member.node),
            chunks=started,
            spared=tuple(number for number in member.chunks if number not in started),
            is_node_lost=is_fault_of_node,
        )
        if not (member.is_taken and started):
            self.send(lost)
            return
        answer = self.nodes.check(member.node)
        end = time.monotonic() + CHECK_TIMEOUT_S
        loss = SuspectedLoss(node=member.node, lost=lost, answer=answer, end=end)
        self._suspected.append(loss)
        call_after(self.calls, answer, lambda _: self.report_answered())

    def report_answered(self) -> None:
        """Report the losses whose nodes have answered, or had the time to."""
        now = time.monotonic()
        for loss in [loss for loss in self._suspected if loss.answer.done() or now > loss.end]:
            self._suspected.remove(loss)
            is_lost = loss.is_node_lost(self.nodes.cluster, self.nodes.listed())
            self.send(replace(loss.lost, is_node_lost=is_lost))
