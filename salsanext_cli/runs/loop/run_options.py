# SPDX-License-Identifier: MIT
"""Options of a run over scans: workers, shard, errors, progress."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeVar

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.wording import argument
from salsanext_cli.runs.loop.event_file import EventFile


class Sortable(Protocol):
    """Value with an order among those of its class."""

    def __lt__(self, other: Any, /) -> bool:
        """Return whether it comes before another."""


CHUNKS_IN_FLIGHT = 2  # Chunks sent per worker, so that the next is ready when one is done

Unit = TypeVar("Unit", bound=Sortable)
Progress = Callable[[int, int], None]  # Called with the numbers of scans done and to do


def cores() -> int:
    """Return the number of cores that this process may use, which on a cluster are a share."""
    import joblib

    return int(joblib.cpu_count())


def worker_count(jobs: int) -> int:
    """Return the number of workers of `jobs`; -1 is one per core."""
    if jobs == 0 or jobs < -1:
        expected = "a number of workers, or -1 for all cores"
        raise UsageError(argument("jobs"), str(jobs), expected)
    return cores() if jobs == -1 else jobs


@dataclass(frozen=True, slots=True)
class Shard:
    """Share of the scans of a run: `number` of `count`, from 1."""

    number: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise UsageError(argument("shard"), str(self), "i/n with i from 1 to n")

    def __str__(self) -> str:
        return f"{self.number}/{self.count}"

    def select(self, units: Sequence[Unit]) -> list[Unit]:
        """Return this shard's scans or bags, neighbours by their order; sizes differ by one."""
        if self.count == 1:
            return list(units)
        ordered = sorted(units)
        start, stop = (len(ordered) * n // self.count for n in (self.number - 1, self.number))
        return ordered[start:stop]


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run over scans."""

    # Number of workers; None for 1, and on a GPU as many as keep it busy (`measured_workers`)
    jobs: int | None = 1
    # Address of a Ray cluster whose workers take the place of `jobs`
    cluster: str | None = None
    shard: Shard = Shard()
    overwrite: bool = False
    on_error: Literal["skip", "stop"] = "skip"
    # File that gets a line for each scan that has ended
    events: EventFile | None = None
    # Called before the first scan and after each; for those of a chunk when its worker has ended it
    progress: Progress | None = None

    def __post_init__(self) -> None:
        self.workers()
        if self.cluster is not None and self.jobs not in (None, 1):
            problem = "both were given"
            raise UsageError(argument("jobs", "cluster"), problem, "one of them")

    def workers(self) -> int:
        """Return the number of workers with which a run begins."""
        return 1 if self.jobs is None else worker_count(self.jobs)
