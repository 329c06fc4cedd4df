# SPDX-License-Identifier: MIT
"""Chunks of a run on a cluster: which one is next, and what becomes of one whose worker is lost."""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import count

from salsanext_cli.runs.loop.pool import Chunk
from salsanext_cli.runs.scans.scan_file import ScanFile

MAX_LOSSES = 2
"""Lost workers that had only one scan after which that scan fails."""
MAX_LOST_NODES = 3
"""Lost nodes whose worker had only one scan after which that scan fails."""
MAX_SPARED = 3
"""Lost workers that had not started a chunk after which it is charged with each further one: it may
end its worker before the confirmation of its start arrives."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SentChunk:
    """Chunk as it is sent.

    Attributes
    ----------
    number : int
        Number under which it is sent, a new one each time.
    scans : tuple of ScanFile
        Its scans.
    is_alone : bool
        Whether its worker gets no other chunk meanwhile, so that a loss has one cause.
    losses : int
        Number of workers that were lost with this chunk alone.
    lost_nodes : int
        Number of nodes that were lost while a worker had this scan alone.
    owns_node : bool
        Whether no other worker of its node gets a chunk alone meanwhile: it may bring nodes down.
    lost_on : str
        Name of the node on which it was last lost or had an unexpected exception.
    has_bug : bool
        Whether it has had an unexpected exception.
    spared : int
        Number of workers that were lost before they started this chunk.
    """

    number: int
    scans: Chunk
    is_alone: bool = False
    losses: int = 0
    lost_nodes: int = 0
    owns_node: bool = False
    lost_on: str = ""
    has_bug: bool = False
    spared: int = 0


class ChunkQueue:
    """Chunks that wait or were sent, by the number under which they were sent.

    Parameters
    ----------
    chunks : iterable of Chunk
        All chunks of the run.
    """

    def __init__(self, chunks: Iterable[Chunk]) -> None:
        self._waiting = deque(SentChunk(number=0, scans=chunk) for chunk in chunks)
        self._sent: dict[int, SentChunk] = {}
        self._numbers = count(1)

    def __bool__(self) -> bool:
        """Whether any chunk waits or was sent."""
        return bool(self._waiting or self._sent)

    @property
    def is_waiting(self) -> bool:
        """Whether any chunk waits."""
        return bool(self._waiting)

    def send(self) -> SentChunk:
        """Return the next chunk, with a number."""
        chunk = replace(self._waiting.popleft(), number=next(self._numbers))
        self._sent[chunk.number] = chunk
        return chunk

    def scans(self, number: int) -> Chunk:
        """Return the scans of a chunk that was sent."""
        return self._sent[number].scans

    def finish(self, number: int) -> None:
        """Forget a chunk that was attempted."""
        del self._sent[number]

    def retry(self, number: int, node: str) -> bool:
        """Let a chunk with an unexpected exception wait again; return False after a second one.

        `node`: name of the node.
        """
        chunk = self._sent.pop(number)
        if chunk.has_bug:
            return False
        again = replace(chunk, is_alone=True, lost_on=node, has_bug=True)
        self._waiting.appendleft(again)
        return True

    def spare(self, number: int, node: str) -> ScanFile | None:
        """Let a chunk wait again as it is, whose worker was lost before it started it.

        Parameters and result are those of `lose`.
        """
        chunk = self._sent[number]
        if chunk.spared >= MAX_SPARED:
            return self.lose(number, node=node)
        del self._sent[number]
        self._waiting.appendleft(replace(chunk, spared=chunk.spared + 1, lost_on=node))
        return None

    def lose(self, number: int, *, is_node_lost: bool = False, node: str = "") -> ScanFile | None:
        """Let a chunk of a lost worker wait again: alone, and after a second loss in scans.

        Parameters
        ----------
        number : int
            Number under which the chunk was sent.
        is_node_lost : bool
            Whether the node of the worker is lost, which is no fault of a scan until it happens
            again and again.
        node : str
            Name of the node.

        Returns
        -------
        ScanFile, optional
            The scan that has ended its workers or nodes, which does not wait again.
        """
        chunk = replace(self._sent.pop(number), lost_on=node)
        if not chunk.is_alone:
            self._waiting.appendleft(replace(chunk, is_alone=True))
        elif len(chunk.scans) > 1:
            owned = replace(chunk, owns_node=is_node_lost)
            self._waiting.extendleft(replace(owned, scans=(scan,)) for scan in chunk.scans[::-1])
        elif is_node_lost and chunk.lost_nodes + 1 < MAX_LOST_NODES:
            again = replace(chunk, lost_nodes=chunk.lost_nodes + 1, owns_node=True)
            self._waiting.appendleft(again)
        elif not is_node_lost and chunk.losses + 1 < MAX_LOSSES:
            self._waiting.appendleft(replace(chunk, losses=chunk.losses + 1))
        else:
            return chunk.scans[0]
        return None
