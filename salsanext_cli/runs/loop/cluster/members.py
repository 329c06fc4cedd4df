# SPDX-License-Identifier: MIT
"""Records of the driver about its workers, and about those that were lost."""

from collections.abc import Callable, Collection, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from salsanext_cli.runs.loop.cluster.messages import PackedChunk
from salsanext_cli.runs.loop.cluster.node_code import NodeProblem
from salsanext_cli.runs.loop.run_options import CHUNKS_IN_FLIGHT


@dataclass(slots=True, kw_only=True, eq=False)
class Member:
    """Worker that was started, or waits for room on a node."""

    handle: Any
    node: str = ""  # Id of its node, once it has started
    nodes: frozenset[str] = frozenset()  # Ids of those that there were when it was started
    located_at: float = 0.0  # Time at which it has started
    is_open: bool = False  # Whether it has opened the task
    chunks: list[int] = field(default_factory=list)  # Numbers
    is_taken: bool = False  # Whether it gets no other chunk beside the one that it has
    owns_node: bool = False  # Whether no other worker of its node gets a chunk alone

    @property
    def places(self) -> int:
        """Number of further chunks that it can take."""
        return CHUNKS_IN_FLIGHT - len(self.chunks) if self.is_open and not self.is_taken else 0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SuspectedLoss:
    """Loss of a worker with a chunk that was sent alone, until it is known whether its node lives.

    Attributes
    ----------
    node : str
        Id of the node.
    chunks : tuple of int
        Numbers of the chunks of the worker.
    answer : Future
        Check of the node, which fails if the node is lost.
    end : float
        Time at which a node without an answer counts as lost.
    """

    node: str
    chunks: tuple[int, ...]
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


def idle_member(
    members: Sequence[Member], chunk: PackedChunk, name: Callable[[str], str]
) -> Member | None:
    """Return an idle worker for a chunk alone: if possible, not where the chunk was lost.

    Parameters
    ----------
    members : sequence of Member
        Workers that have opened the task.
    chunk : PackedChunk
        The chunk.
    name : callable
        Returns the name of a node by its id.
    """
    elsewhere = [member for member in members if name(member.node) != chunk.lost_on]
    full = {
        member.node
        for member in members
        if member.owns_node or (member.is_taken and chunk.owns_node)
    }
    for member in elsewhere or members:
        if not member.chunks and member.node not in full:
            return member
    return None
