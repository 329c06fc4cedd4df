# SPDX-License-Identifier: MIT
"""Messages between the main process, the driver of a cluster, and its workers.

They are pickled, because each process has started the next one. Scans and attempts are pickled
within them, so that the driver passes them on without reading them.
"""

import pickle
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import IO, Any

from salsanext_cli.runs.loop.cluster.node_code import NodeRequirements

Send = Callable[[object], None]
"""Function of the driver that sends a message to the main process."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Assignment:
    """What the driver needs to start workers: the first message to it.

    Attributes
    ----------
    address : str
        Address of the cluster.
    work : bytes
        Pickled `Work` of the module `work`.
    required : NodeRequirements
        What each node needs.
    scans : int
        Number of scans, the upper bound of that of workers.
    worker_memory : int
        Memory of a worker in bytes.
    uses_gpu : bool
        Whether each worker gets a GPU.
    """

    address: str
    work: bytes
    required: NodeRequirements
    scans: int
    worker_memory: int
    uses_gpu: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class PackedChunk:
    """Chunk to attempt, to the driver."""

    number: int
    scans: bytes  # Pickled tuple of scans
    is_alone: bool = False  # Whether its worker gets no other chunk meanwhile
    owns_node: bool = False  # Whether no other worker of its node gets a chunk alone meanwhile
    lost_on: str = ""  # Name of a node that does not get it while there are others


@dataclass(frozen=True, slots=True, kw_only=True)
class Joined:
    """The driver has joined the cluster, whose nodes have what the run needs."""

    nodes: int
    workers: int  # Number of workers that the nodes have room for, which may be 0
    unused_gpus: int = 0  # Number of GPUs of the cluster that no worker gets


@dataclass(frozen=True, slots=True, kw_only=True)
class NotJoined:
    """There is no such cluster, or it cannot be joined."""

    problem: str


@dataclass(frozen=True, slots=True, kw_only=True)
class UnusableNode:
    """A node lacks what the run needs.

    Attributes
    ----------
    node : str
        Name of the node.
    problem : str
        What it lacks, in words.
    hint : str
        What to do about it.
    trace : str
        Traceback of a problem that no user can correct.
    ends_run : bool
        Whether the run cannot begin; otherwise the other nodes go on.
    """

    node: str
    problem: str
    hint: str = ""
    trace: str = ""
    ends_run: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Alive:
    """The driver goes on, and its cluster answers: sent every few seconds during a run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Waiting:
    """No worker has been free for some time."""

    seconds: float
    room: str = ""  # What a worker needs, in words


@dataclass(frozen=True, slots=True, kw_only=True)
class FreePlaces:
    """Workers have places for this number of further chunks."""

    count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class FinishedChunk:
    """Result of a chunk."""

    number: int
    attempts: bytes  # Pickled `AttemptedChunk` or `Bug`
    node: str = ""  # Name


@dataclass(frozen=True, slots=True, kw_only=True)
class LostWorker:
    """A worker ended without an order.

    Attributes
    ----------
    node : str
        Name of its node.
    chunks : tuple of int
        Numbers of the chunks that it had started, and that may have ended it.
    spared : tuple of int
        Numbers of its other chunks. If its node lacks something, no chunk has ended it.
    is_node_lost : bool
        Whether its node is lost or lacks something, which is found out if it had a chunk alone.
    """

    node: str
    chunks: tuple[int, ...] = ()
    spared: tuple[int, ...] = ()
    is_node_lost: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LongChunk:
    """Chunk that a worker has had for long."""

    number: int
    node: str  # Name of the node
    process: int  # Id of the process on the node
    seconds: float  # Time since its start


@dataclass(frozen=True, slots=True, kw_only=True)
class LongChunks:
    """Chunks that take long since the last such message."""

    chunks: tuple[LongChunk, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class LostCluster:
    """The cluster does not answer any more."""

    problem: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Crash:
    """The driver has a bug."""

    trace: str


def messages_from(stream: IO[bytes]) -> Iterator[Any]:
    """Yield the messages of another process until it sends no more."""
    while True:
        try:
            yield pickle.load(stream)  # noqa: S301 - of the process at the other end of a pipe
        except (EOFError, pickle.UnpicklingError):
            return
