# SPDX-License-Identifier: MIT
"""Chunks of scans for workers: large enough to be worth a message, small enough to share."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby, pairwise

from salsanext_cli.storage.layout import ScanFile

MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4
"""Lower bound, so that the last chunks end at about the same time."""

Chunk = tuple[ScanFile, ...]


def chunks(scans: Sequence[ScanFile], workers: int) -> list[Chunk]:
    """Cut scans into chunks, in order; each holds neighbours of one sequence.

    Parameters
    ----------
    scans : sequence of ScanFile
        In the order in which they are to be begun.
    workers : int
        Number of chunks that are worked on side by side.

    Returns
    -------
    list of tuple of ScanFile
        Of at most `MAX_CHUNK_SCANS` scans, and at least `MIN_CHUNKS_PER_WORKER` for each worker if
        there are so many scans. Those of a sequence differ by one scan at most.
    """
    size = max(1, min(MAX_CHUNK_SCANS, len(scans) // (MIN_CHUNKS_PER_WORKER * workers)))
    cut: list[Chunk] = []
    for _, group in groupby(scans, key=lambda scan: scan.sequence):
        run = tuple(group)
        parts = -(-len(run) // size)
        borders = [len(run) * part // parts for part in range(parts + 1)]
        cut += [run[start:stop] for start, stop in pairwise(borders)]
    return cut
