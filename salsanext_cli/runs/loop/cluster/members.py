# SPDX-License-Identifier: MIT
"""Record of the driver about a worker, and the choice of one for a chunk alone."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from salsanext_cli.runs.loop.cluster.messages import PackedChunk
from salsanext_cli.runs.loop.run_options import CHUNKS_IN_FLIGHT


@dataclass(slots=True, kw_only=True)
class StartedChunk:
    """Chunk whose start its worker has confirmed."""

    since: float  # Time of the confirmation
    process: int  # Id of the process on its node
    is_reported: bool = False  # Whether the user knows that it takes long


@dataclass(slots=True, kw_only=True, eq=False)
class Member:
    """Worker that was started, or waits for room on a node."""

    handle: Any
    node: str = ""  # Id of its node, once it has started
    nodes: frozenset[str] = frozenset()  # Ids of those that there were when it was started
    located_at: float = 0.0  # Time at which it has started
    is_open: bool = False  # Whether it has opened the task
    chunks: list[int] = field(default_factory=list)  # Numbers
    started: dict[int, StartedChunk] = field(default_factory=dict)  # Of these, by number
    is_taken: bool = False  # Whether it gets no other chunk beside the one that it has
    owns_node: bool = False  # Whether no other worker of its node gets a chunk alone

    @property
    def places(self) -> int:
        """Number of further chunks that it can take."""
        return CHUNKS_IN_FLIGHT - len(self.chunks) if self.is_open and not self.is_taken else 0


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
