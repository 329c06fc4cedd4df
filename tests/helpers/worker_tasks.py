# SPDX-License-Identifier: MIT
"""Work for all kinds of workers: light, and sometimes deadly.

Each worker process imports this file, and what it imports is most of the start of a process.
"""

import os
import pickle
import signal
import time
from collections.abc import Callable, Generator, Sequence
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.atomic import writing
from salsanext_cli.runs.loop.job import Attempt, Task
from salsanext_cli.runs.loop.pipeline import opened
from salsanext_cli.runs.loop.pool import chunks
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.scans.scan_file import ScanFile


class Write:
    """Write a scan's stem into a file; some stems mean trouble, unless this is peaceful."""

    def __init__(self, out: Path, pause: float = 0.0, *, peaceful: bool = False) -> None:
        self.out, self.pause, self.peaceful = out, pause, peaceful

    def path(self, scan: ScanFile) -> Path:
        """Return the file that is written for a scan."""
        return self.out / scan.sequence / scan.stem

    def __call__(self, scan: ScanFile) -> str:
        """Write, fail, or die."""
        trouble = "" if self.peaceful else scan.stem
        if trouble.startswith("bad"):
            raise FormatError(scan.path, "cut off")
        if trouble.startswith("bug"):
            raise ZeroDivisionError("a bug of ours")
        with writing(self.path(scan)) as file:
            if trouble.startswith("killed"):
                os.kill(os.getpid(), signal.SIGKILL)
            if trouble.startswith("ctrl-c"):
                os.kill(os.getpid(), signal.SIGINT)
            time.sleep(self.pause)
            file.write(scan.stem.encode())
        return scan.stem


class Opens(Write):
    """Record each process that opens this in a file."""

    max_chunk_scans = 16

    def open(self) -> Callable[[ScanFile], str]:
        """Note the process."""
        with (self.out / "opened").open("a") as file:
            file.write(f"{os.getpid()}\n")
        return self.__call__


def name_argument(scan: ScanFile) -> str:
    """Return how this process spells an argument."""
    return argument("min_range")


def threads_of_process(_: ScanFile) -> tuple[int, int]:
    """Return the number of threads of torch and of kernels."""
    import torch  # here, since it takes a second, and numba half of one

    from salsanext_cli.core.compiled import thread_count

    return torch.get_num_threads(), thread_count()


def scans_of(*stems: str, sequence: str = "s") -> list[ScanFile]:
    """Return scans that nobody reads."""
    return [
        ScanFile(sequence=sequence, stem=stem, path=Path("/scans") / f"{stem}.bin")
        for stem in stems
    ]


def attempts_in_process(
    task: Task, scans: Sequence[ScanFile], options: RunOptions
) -> Generator[Attempt[Any], None, None]:
    """Yield attempts as workers do, but in this process: by a copy, of the last scans first."""
    attempts = opened(pickle.loads(pickle.dumps(task)))
    for chunk in reversed(chunks(scans, options.workers())):
        yield from attempts(chunk, lambda _: None)
