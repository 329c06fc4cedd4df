# SPDX-License-Identifier: MIT
"""Progress of a command on stderr, and what is finished if it is interrupted."""

import dataclasses
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from salsanext_cli.commands.line.output.console import print_line
from salsanext_cli.commands.line.output.interruption import (
    NO_HALF_FILES,
    on_interruption,
    require_uninterrupted,
)
from salsanext_cli.core.notices import demote_reader_notices

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from salsanext_cli.runs.loop.run_options import Progress, RunOptions

LINE_INTERVAL_S = 30.0  # Time between two lines of progress in a log file


@contextmanager
def progress_display(label: str, quiet: bool, unit: str = "scans") -> Iterator["Progress | None"]:
    """Show the progress of the body on stderr: units done, rate and time left."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        with _bar(unit) as bar:
            task = bar.add_task(label, total=None)
            yield lambda done, total: bar.update(task, completed=done, total=total)
    else:
        yield ProgressLines(label, unit)


@dataclasses.dataclass(slots=True, eq=False, kw_only=True)
class ProcessedUnits:
    """Progress of a body that writes the results of each unit, or all of them at its end."""

    unit: str  # Plural, such as "scans"
    at_end: bool
    show: "Progress | None"  # Shows the progress, if anything does
    done: int = 0  # Number of processed units
    total: int = 0  # Number of all units

    def __call__(self, done: int, total: int) -> None:
        """Note and show the number of processed units and of all; end after a dropped signal."""
        self.done = done
        self.total = total
        if self.show:
            self.show(done, total)
        if sys.exception() is None:  # Otherwise the run is ending already.
            require_uninterrupted()

    def finished(self) -> str:
        """State what is finished, in words."""
        if self.at_end:
            return f"nothing is finished; {NO_HALF_FILES}"
        if not self.done:
            return f"no {self.unit[:-1]} is finished in this run"
        return f"{self.done} of {self.total} {self.unit} are processed; {NO_HALF_FILES}"


@contextmanager
def writing(
    label: str, quiet: bool, unit: str = "scans", *, at_end: bool = False
) -> Iterator["Progress"]:
    """Show the progress of the body, and state what is finished if it is interrupted."""
    with progress_display(label, quiet, unit) as show:
        units = ProcessedUnits(unit=unit, at_end=at_end, show=show)
        with on_interruption(units.finished):
            yield units


@contextmanager
def over_scans(
    label: str, options: "RunOptions", quiet: bool, *, at_end: bool = False
) -> Iterator["RunOptions"]:
    """Show the progress of a run over scans, which takes the options of the context.

    `at_end`: whether it writes its results at the end, and not those of each scan.
    """
    events = options.events and dataclasses.replace(options.events, command=label)
    with writing(label, quiet, at_end=at_end) as bar:
        yield dataclasses.replace(options, progress=bar, events=events)


@contextmanager
def over_results(
    label: str, options: "RunOptions", quiet: bool, *, at_end: bool = False
) -> Iterator["RunOptions"]:
    """Do what `over_scans` does for scans that an earlier command has read.

    That command has printed what readers assume about their files.
    """
    with demote_reader_notices(), over_scans(label, options, quiet, at_end=at_end) as running:
        yield running


@dataclasses.dataclass(frozen=True, slots=True)
class UnitsAtTime:
    """Number of units that were done at a time."""

    done: int
    time: float  # Seconds of a clock


class ProgressLines:
    """Progress as lines of text, at most one in `LINE_INTERVAL_S` of a clock in seconds.

    The rate is measured from the first finished unit on, because that one includes the time to
    load and compile the network.
    """

    def __init__(self, label: str, unit: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.label = label
        self.unit = unit
        self.clock = clock
        self.last = clock()
        self.first: UnitsAtTime | None = None

    def __call__(self, done: int, total: int) -> None:
        """Print a line if one is due."""
        if not done:
            self.first = None  # A run over scans begins, such as the second one of `pick`.
            return
        now = self.clock()
        if self.first is None:
            self.first = UnitsAtTime(done, now)
        if now - self.last < LINE_INTERVAL_S or done == total:
            return
        self.last = now
        texts = [f"{done}/{total} {self.unit}"]
        if done > self.first.done:
            seconds = (now - self.first.time) / (done - self.first.done)
            left = duration_text(seconds * (total - done))
            texts += [rate_text(1 / seconds, self.unit), f"{left} left"]
        print_line(f"{self.label}: {', '.join(texts)}")


def rate_text(rate: float, unit: str) -> str:
    """Return units per second as text, or seconds per unit if that is more than one."""
    return f"{rate:.1f} {unit}/s" if rate >= 1 else f"{1 / rate:.1f} s/{unit[:-1]}"


def duration_text(seconds: float) -> str:
    """Return a duration as text, such as "53 ms", "12.3 s" or "12 min 5 s"."""
    if seconds < 1:
        return f"{1000 * seconds:.0f} ms"
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 100:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def _bar(unit: str) -> "Bar":
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        Task,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class RateColumn(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text(rate_text(speed, unit) if speed else "")

    return Progress(
        "{task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        RateColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        console=Console(stderr=True),
    )
