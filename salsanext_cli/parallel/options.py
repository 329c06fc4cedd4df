# SPDX-License-Identifier: MIT
"""Options of a run over scans: workers, backend, shard, errors, progress."""

from collections.abc import Callable
from dataclasses import dataclass

from salsanext_cli.errors import UsageError
from salsanext_cli.parallel.shards import Shard
from salsanext_cli.parallel.threads import worker_count

BACKENDS = ("loky", "threading", "dask", "ray")
CLUSTERS = ("dask", "ray")
"""Backends whose workers may be on other machines."""

Progress = Callable[[int, int], None]
"""Called with the number of scans done and the number of scans to do."""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run over scans."""

    # Workers side by side; -1 is one per core, or all of a cluster. None is one here, and all of a
    # cluster
    jobs: int | None = None
    # {"skip", "stop"}: a scan that fails is named at the end, or ends the run
    on_error: str = "skip"
    overwrite: bool = False  # Results that exist are made again
    # Called after each scan, or for several together when a worker is done with them
    progress: Progress | None = None
    # {"loky", "threading", "dask", "ray"}: processes, threads, or the workers of a cluster
    backend: str = "loky"
    # Address of a Dask or Ray cluster; without one, it is started on this machine
    scheduler: str | None = None
    # Share of the scans that this run works on, where other runs work on the others
    shard: Shard = Shard()

    def __post_init__(self) -> None:
        worker_count(1 if self.jobs is None else self.jobs)
        if self.on_error not in ("skip", "stop"):
            raise UsageError("--on-error", self.on_error, "skip or stop")
        if self.backend not in BACKENDS:
            raise UsageError("--backend", self.backend, f"one of {', '.join(BACKENDS)}")
        if self.scheduler is not None and self.backend not in CLUSTERS:
            raise UsageError(
                f"--scheduler {self.scheduler}", f"--backend {self.backend}", "dask or ray"
            )

    def workers_here(self) -> int:
        """Return how many workers are wanted on this machine."""
        default = -1 if self.backend in CLUSTERS else 1
        return worker_count(default if self.jobs is None else self.jobs)

    def workers_of_cluster(self) -> int | None:
        """Return how many workers of a cluster are wanted, None for all."""
        return None if self.jobs in (None, -1) else self.jobs
