# SPDX-License-Identifier: MIT
"""Nodes of a cluster, and what a worker takes of them."""

from collections.abc import Sequence
from dataclasses import dataclass

from salsanext_cli.core.texts import counted

MAX_CORES_PER_WORKER = 4
"""Cores of a worker without a GPU; with more, a network gains less than further workers."""
MAX_CORES_PER_GPU = 8
"""Cores of a worker with a GPU, which read and project its scans."""
MIN_SHARE = 0.75
"""Share of the GPUs, or else of the cores, of a cluster that its workers use: small nodes do not
make all workers small."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Node:
    """Node of a cluster."""

    id: str
    name: str
    cores: int
    gpus: int
    memory: int  # Bytes that Ray gives to workers


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerSize:
    """Resources of a worker."""

    cores: int
    gpus: int
    memory: int  # Bytes that Ray reserves

    @classmethod
    def fitting(cls, nodes: Sequence[Node], *, uses_gpu: bool, memory: int) -> "WorkerSize":
        """Return the largest size that uses most GPUs, or else most cores, of the nodes.

        `memory`: of a worker, in bytes.
        """
        if uses_gpu:
            enough = MIN_SHARE * sum(node.gpus for node in nodes)
            sizes = range(MAX_CORES_PER_GPU, 1, -1)
            fitting = (
                size
                for size in sizes
                if sum(min(node.gpus, node.cores // size) for node in nodes) >= enough
            )
            return cls(cores=next(fitting, 1), gpus=1, memory=memory)
        enough = MIN_SHARE * sum(node.cores for node in nodes)
        sizes = range(MAX_CORES_PER_WORKER, 0, -1)
        cores = next(
            size for size in sizes if sum(node.cores // size * size for node in nodes) >= enough
        )
        return cls(cores=cores, gpus=0, memory=memory)

    def __str__(self) -> str:
        gpu = "a GPU, " if self.gpus else ""
        memory = f"{self.memory / 1e9:.1f} GB of memory"
        return f"{gpu}{counted(self.cores, 'core')} and {memory}"

    def places(self, node: Node) -> int:
        """Return the number of workers that a node has room for."""
        places = min(node.cores // self.cores, node.memory // self.memory)
        return min(places, node.gpus) if self.gpus else places
