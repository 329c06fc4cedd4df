# SPDX-License-Identifier: MIT
"""Task of a run as the workers of a cluster get it."""

from dataclasses import dataclass

from salsanext_cli.runs.loop.job import Task
from salsanext_cli.runs.loop.pool import (
    AttemptedChunk,
    Chunk,
    WorkerProcess,
    attempt_chunk,
    opened_once,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """Task of a run, what its workers have from the main process, and when a chunk ends."""

    task: Task
    process: WorkerProcess
    stop: bool  # Whether a chunk ends at the first failure

    def open(self) -> None:
        """Open the task in this process."""
        opened_once(self.task, self.process)

    def attempt(self, chunk: Chunk, number: int) -> AttemptedChunk:
        """Attempt the scans of a chunk."""
        return attempt_chunk(self.task, self.process, chunk, number, None, stop=self.stop)
