# SPDX-License-Identifier: MIT
"""Division of scans: into shards for runs that know nothing of each other, chunks for workers."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby, pairwise
from typing import TYPE_CHECKING

from salsanext_cli.errors import NOTICE, UsageError

if TYPE_CHECKING:
    from salsanext_cli.results.layout import ScanFile

PREFIX = "SLURM_ARRAY_TASK_"
MAX_CHUNK_SCANS = 16
"""Bound of the work that is lost with a worker, and of the scans between signs of progress."""
MIN_CHUNKS_PER_WORKER = 4
"""Lower bound, so that the last chunks end at about the same time."""

Chunk = tuple["ScanFile", ...]

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Shard:
    """Share of the scans that a run works on."""

    number: int = 1  # From 1 to `count`
    count: int = 1  # Number of shards

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise UsageError("--shard", str(self), "i/n with i from 1 to n")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Read ``i/n``, counted from 1."""
        found = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        if not found:
            raise UsageError("--shard", repr(text), "i/n, such as 1/8")
        return cls(int(found[1]), int(found[2]))

    @classmethod
    def asked_for(cls, text: str | None) -> Shard:
        """Read ``i/n``; without it, return the share of this task of a Slurm array, else all."""
        if text is not None:
            return cls.parse(text)
        if (of_array := cls.of_slurm(os.environ)) is None:
            return cls()
        log.log(NOTICE, "shard %s of the scans, as this is a task of a Slurm array", of_array)
        return of_array

    @classmethod
    def of_slurm(cls, environment: Mapping[str, str]) -> Shard | None:
        """Return the shard of a task of a Slurm array, None outside of one.

        Arrays begin where their user likes, at 0 or 1, and may count in steps.
        """
        names = [PREFIX + name for name in ("ID", "MIN", "COUNT")]
        if any(name not in environment for name in names):
            return None
        texts = (*map(environment.__getitem__, names), environment.get(PREFIX + "STEP", "1"))
        digits = re.compile(r"\d{1,9}", re.ASCII)
        number, least, count, step = (int(t) if digits.fullmatch(t) else -1 for t in texts)
        index, rest = divmod(number - least, max(1, step))
        if rest or min(number, least, step) < 0 or not 0 <= index < count:
            raise UsageError(
                f"{names[0]}={texts[0]}",
                f"an array of {texts[2]} tasks from {texts[1]} in steps of {texts[3]}",
                "numbers without gaps",
                "say which share with --shard i/n",
            )
        return cls(index + 1, count)

    def of(self, scans: Sequence[ScanFile]) -> list[ScanFile]:
        """Return this shard's scans, neighbours of each other, in order of sequence and stem.

        All shards together have every scan once, and differ in size by one at most, if all are
        given the same scans, in any order.
        """
        if self.count == 1:
            return list(scans)
        ordered = sorted(scans)
        start, stop = (len(ordered) * n // self.count for n in (self.number - 1, self.number))
        return ordered[start:stop]


def chunks(scans: Sequence[ScanFile], workers: int) -> list[Chunk]:
    """Cut scans into chunks, in order; each holds neighbours of one sequence.

    They have at most `MAX_CHUNK_SCANS` scans, and those of a sequence differ by one at most; each
    worker has at least `MIN_CHUNKS_PER_WORKER` if there are so many scans.
    """
    size = max(1, min(MAX_CHUNK_SCANS, len(scans) // (MIN_CHUNKS_PER_WORKER * workers)))
    cut: list[Chunk] = []
    for _, group in groupby(scans, key=lambda scan: scan.sequence):
        run = tuple(group)
        parts = -(-len(run) // size)
        borders = [len(run) * part // parts for part in range(parts + 1)]
        cut += [run[start:stop] for start, stop in pairwise(borders)]
    return cut
