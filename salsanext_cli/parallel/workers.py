# SPDX-License-Identifier: MIT
"""Send chunks to workers and take in what comes back, in no particular order."""

from __future__ import annotations

import warnings
from collections.abc import Generator, Sequence
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING

import joblib
from joblib.externals.loky.process_executor import TerminatedWorkerError

from salsanext_cli.errors import WorkersLost
from salsanext_cli.parallel.backends import WorkerPool, block_interrupts, crew
from salsanext_cli.parallel.chunks import chunks
from salsanext_cli.parallel.futures import Loss
from salsanext_cli.parallel.tasks import Attempt, Work, WorkerContext, attempt_chunk
from salsanext_cli.storage.layout import ScanFile

if TYPE_CHECKING:
    from salsanext_cli.parallel.run import RunOptions

HARMLESS = (
    # Who stops a run knows that it has been stopped.
    ".*tasks which were still being processed",
    # A worker that grows, as it does when it loads a network, is replaced by a fresh one.
    "A worker stopped while some jobs were given",
)
"""Warnings of joblib that say nothing to a user; raised as errors, they would stop its threads."""


def attempts_of_workers(
    work: Work, scans: Sequence[ScanFile], options: RunOptions, context: WorkerContext
) -> Generator[Attempt, None, None]:
    """Yield the attempts of all scans as workers are done with them, a chunk at a time.

    A chunk that a cluster lost does not keep the others from being done.

    Raises
    ------
    WorkersLost
        If attempts are missing; after all others, unless the errand is to stop.
    """
    with crew(options, len(scans), context) as team, _ignoring(HARMLESS):
        yield from _attempts(team, work, scans, options)


def _attempts(
    team: WorkerPool, work: Work, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt, None, None]:
    calls = (
        joblib.delayed(attempt_chunk)(team.context, work, chunk)
        for chunk in chunks(scans, team.workers)
    )
    lost: list[Loss] = []
    with joblib.parallel_config(**team.parallel):
        parallel = joblib.Parallel(
            return_as="generator_unordered", batch_size=1, pre_dispatch=team.in_flight
        )
        try:
            with block_interrupts():
                found = parallel(calls)
            with closing(found):
                for of_chunk in found:
                    if not isinstance(of_chunk, Loss):
                        yield from of_chunk
                        continue
                    lost.append(of_chunk)
                    if team.context.stop:
                        break
        except TerminatedWorkerError as error:
            raise WorkersLost(
                f"--jobs {team.workers}",
                "the system ended a process",
                "memory for all of them",
                "use fewer jobs",
            ) from error
    if lost:
        raise WorkersLost(
            f"--backend {options.backend}",
            f"{len(lost)} chunks of scans were lost, the first as {lost[0].reason}",
            "workers that live, with memory for their work",
            "see what ended them",
        )


@contextmanager
def _ignoring(harmless: Sequence[str]) -> Generator[None, None, None]:
    with warnings.catch_warnings():
        for message in harmless:
            warnings.filterwarnings("ignore", message)
        yield
