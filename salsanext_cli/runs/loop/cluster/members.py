# SPDX-License-Identifier: MIT
"""Records of the driver about its workers, and about those that were lost."""

from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Any

from salsanext_cli.runs.loop.cluster.node_code import NodeProblem

CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is ready when one is done


@dataclass(slots=True, kw_only=True, eq=False)
class Member:
    """Worker that was started, or waits for room on a node."""

    handle: Any
    node: str = ""  # Id of its node, once it has started
    located_at: float = 0.0  # Time at which it has started
    is_open: bool = False  # Whether it has opened the task
    chunks: list[int] = field(default_factory=list)  # Numbers
    is_taken: bool = False  # Whether it gets no other chunk beside the one that it has

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
