# SPDX-License-Identifier: MIT
"""Nodes of a cluster, and what a worker takes of them."""

from collections.abc import Sequence
from dataclasses import dataclass

MAX_CORES_PER_WORKER = 4
"""Cores of a worker without a GPU; with more, a network gains less than further workers."""
MAX_CORES_PER_GPU = 8
"""Cores of a worker with a GPU, which read and project its scans."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """Node of a cluster."""

    id: str
    name: str
    cores: int
    gpus: int


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSize:
    """Resources of a worker."""

    cores: int
    gpus: int

    @classmethod
    def fitting(cls, nodes: Sequence[Node], *, uses_gpu: bool) -> "WorkerSize":
        """Return a size that fits on each node with a GPU, or with cores."""
        if uses_gpu:
            shares = [node.cores // node.gpus for node in nodes if node.gpus]
            return cls(cores=max(1, min([MAX_CORES_PER_GPU, *shares])), gpus=1)
        cores = [node.cores for node in nodes if node.cores]
        return cls(cores=min([MAX_CORES_PER_WORKER, *cores]), gpus=0)

    def places(self, node: Node) -> int:
        """Return the number of workers that a node has room for."""
        by_cores = node.cores // self.cores
        return min(by_cores, node.gpus) if self.gpus else by_cores
