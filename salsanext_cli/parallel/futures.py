# SPDX-License-Identifier: MIT
"""A backend for joblib that sends calls to whatever returns futures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from joblib.parallel import ParallelBackendBase


@dataclass(frozen=True, slots=True)
class Loss:
    """A chunk that did not come back, and why: its worker died, more than once."""

    reason: str


class Future(Protocol):
    """What a pool returns for a call."""

    def add_done_callback(self, callback: Callable[[Any], object], /) -> object:
        """Call something with this when it is done, however it ended."""


class Pool(Protocol):
    """Workers, here or elsewhere."""

    def send(self, call: Callable[[], Any]) -> Future:
        """Let a worker make a call."""

    def result_of(self, future: Any) -> Any:
        """Return what a call returned, or a `Loss`; raise what it raised."""

    def cancel(self, futures: list[Any]) -> None:
        """Let go of calls; those that have begun may go on to their end."""


class FuturesBackend(ParallelBackendBase):  # type: ignore[misc]
    """Connects joblib with a pool.

    Joblib has backends of these names. Its threads are left running when a run ends early. Its
    Dask backend keeps arguments on single workers, so that what was to be done next is lost with
    one of them, and waits for ever for a task that killed its workers. Ray's gives results only
    when all are there, and loses those of a worker that dies.
    """

    supports_retrieve_callback = True

    def __init__(self, pool: Pool, workers: int) -> None:
        super().__init__(nesting_level=0)
        self.pool = pool
        self.workers = workers
        self.pending: set[Any] = set()

    def effective_n_jobs(self, n_jobs: int) -> int:
        """Return how many workers there are; of a single one joblib would do the work itself."""
        return max(2, self.workers)

    def submit(self, func: Callable[[], Any], callback: Callable[[Any], object]) -> Future:
        """Send a call; when it is done, joblib hears of it."""
        future = self.pool.send(func)
        self.pending.add(future)
        future.add_done_callback(callback)
        return future

    def retrieve_result_callback(self, out: Any) -> Any:
        """Return the results of a call, of which there is one; a lost one is a result too."""
        self.pending.discard(out)
        found = self.pool.result_of(out)
        return [found] if isinstance(found, Loss) else found

    def abort_everything(self, ensure_ready: bool = True) -> None:
        """Let go of what is not done."""
        self.pool.cancel([*self.pending])
