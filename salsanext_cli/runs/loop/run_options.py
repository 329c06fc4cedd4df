# SPDX-License-Identifier: MIT
"""Options of a run over scans: workers, shard, errors, progress."""

import logging
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from salsanext_cli.core.errors import NOTICE, UsageError

if TYPE_CHECKING:
    from salsanext_cli.runs.results.paths import ScanFile

Progress = Callable[[int, int], None]  # Called with the numbers of scans done and to do
SLURM_PREFIX = "SLURM_ARRAY_TASK_"

log = logging.getLogger(__name__)


def cores() -> int:
    """Return the number of cores that this process may use, which on a cluster are a share."""
    import joblib

    return int(joblib.cpu_count())


def worker_count(jobs: int) -> int:
    """Return the number of workers of `--jobs`; -1 is one per core."""
    if jobs == 0 or jobs < -1:
        raise UsageError("--jobs", str(jobs), "a number of workers, or -1 for all cores")
    return cores() if jobs == -1 else jobs


@dataclass(frozen=True, slots=True)
class Shard:
    """Share of the scans of a run: `number` of `count`, from 1."""

    number: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise UsageError("--shard", str(self), "i/n with i from 1 to n")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    @classmethod
    def parse(cls, text: str) -> "Shard":
        """Read ``i/n``, counted from 1."""
        parts = re.fullmatch(r"(\d{1,9})/(\d{1,9})", text, re.ASCII)
        if not parts:
            raise UsageError("--shard", repr(text), "i/n, such as 1/8")
        return cls(int(parts[1]), int(parts[2]))

    @classmethod
    def asked_for(cls, text: str | None) -> "Shard":
        """Read ``i/n``; without it, return the share of this task of a Slurm array, else all."""
        if text is not None:
            return cls.parse(text)
        if (of_array := cls.of_slurm(os.environ)) is None:
            return cls()
        log.log(NOTICE, "shard %s of the scans: this is a task of a Slurm array", of_array)
        return of_array

    @classmethod
    def of_slurm(cls, environment: Mapping[str, str]) -> "Shard | None":
        """Return the shard of a task of a Slurm array with any start and step."""
        names = [SLURM_PREFIX + name for name in ("ID", "MIN", "COUNT")]
        if any(name not in environment for name in names):
            return None
        texts = (*map(environment.__getitem__, names), environment.get(SLURM_PREFIX + "STEP", "1"))
        digits = re.compile(r"\d{1,9}", re.ASCII)
        number, least, count, step = (int(t) if digits.fullmatch(t) else -1 for t in texts)
        index, rest = divmod(number - least, max(1, step))
        if rest or min(number, least, step) < 0 or not 0 <= index < count:
            problem = f"the array has {texts[2]} tasks from {texts[1]} in steps of {texts[3]}"
            hint = "name the share with --shard i/n"
            raise UsageError(f"{names[0]}={texts[0]}", problem, "numbers without gaps", hint)
        return cls(index + 1, count)

    def of(self, scans: "Sequence[ScanFile]") -> "list[ScanFile]":
        """Return this shard's scans, neighbours by sequence and stem; sizes differ by one."""
        if self.count == 1:
            return list(scans)
        ordered = sorted(scans)
        start, stop = (len(ordered) * n // self.count for n in (self.number - 1, self.number))
        return ordered[start:stop]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run over scans."""

    jobs: int = 1
    shard: Shard = Shard()
    overwrite: bool = False
    on_error: Literal["skip", "stop"] = "skip"
    # Called after each scan, or for several together when a worker has finished its chunk
    progress: Progress | None = None

    def __post_init__(self) -> None:
        self.workers()

    def workers(self) -> int:
        """Return the number of workers."""
        return worker_count(self.jobs)
