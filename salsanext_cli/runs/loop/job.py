# SPDX-License-Identifier: MIT
"""Work on a scan: a plain function, or a job of three steps."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar, cast, runtime_checkable

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.runs.scans.scan_file import ScanFile

Value = TypeVar("Value")
Prepared = TypeVar("Prepared")
Computed = TypeVar("Computed")
Result = TypeVar("Result", covariant=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Attempt(Generic[Value]):
    """Result of work on a scan, or the error that the user can correct."""

    file: ScanFile
    result: Value | None = None
    error: SalsanextError | None = None

    def get(self) -> Value:
        """Return the result, or raise the error."""
        if self.error:
            raise self.error
        return cast(Value, self.result)


@runtime_checkable
class ScanJob(Protocol[Prepared, Computed, Result]):
    """Work on scans in three steps, on different threads (see `pipeline`)."""

    def prepare(self, file: ScanFile, /) -> Prepared:
        """Read, check and project a scan, in one of several threads."""

    def compute(self, scans: Sequence[Prepared], /) -> Sequence[Computed]:
        """Compute a batch of scans, in the thread that runs the pipeline."""

    def finish(self, scan: Prepared, computed: Computed, /) -> Result:
        """Refine and write the results of a scan, in one thread, in the order of the files."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Steps(Generic[Prepared, Computed, Value]):
    """Job made of three functions."""

    prepare: Callable[[ScanFile], Prepared]
    compute: Callable[[Sequence[Prepared]], Sequence[Computed]]
    finish: Callable[[Prepared, Computed], Value]


@runtime_checkable
class OpenableTask(Protocol):
    """Task that each worker opens once, because opening is slow or scans share data."""

    @property
    def max_chunk_scans(self) -> int:
        """Largest number of scans in a chunk, which a worker is sent together."""

    def open(self) -> Any:
        """Return a function of one scan, a `ScanJob` or a `Pipeline`, for all scans of a worker."""


Task = Callable[[ScanFile], Any] | ScanJob[Any, Any, Any] | OpenableTask
"""Work on scans that `run_over_scans` takes; it can be pickled."""
