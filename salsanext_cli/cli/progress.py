# SPDX-License-Identifier: MIT
"""Progress of a command: a bar on a terminal, a line now and then in a log file."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from salsanext_cli.parallel.options import Progress, RunOptions

LINE_INTERVAL_S = 30.0
"""Time between two lines in a log file."""


def tell(text: str) -> None:
    """Write a line on stderr, above the bar if there is one.

    While a bar is shown, rich stands in for `sys.stderr`. `typer.echo` would go past it, to the
    file behind it, and write into the bar.
    """
    sys.stderr.write(f"{text}\n")


@contextmanager
def progress(label: str, quiet: bool, unit: str = "scans") -> Iterator[Progress | None]:
    """Show on stderr how many units are done, the rate and the time left, while the body runs."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        with _bar(unit) as bar:
            task = bar.add_task(label, total=None)
            yield lambda done, total: bar.update(task, completed=done, total=total)
    else:
        yield Lines(label, unit)


@contextmanager
def over_scans(label: str, options: RunOptions, quiet: bool) -> Iterator[RunOptions]:
    """Show the progress of a run over scans while the body runs with the options it gets."""
    with progress(label, quiet) as bar:
        yield replace(options, progress=bar)


class Lines:
    """Progress as lines of text, one at most every `LINE_INTERVAL_S`."""

    def __init__(self, label: str, unit: str) -> None:
        self.label, self.unit = label, unit
        self.start = self.last = time.monotonic()
        self.before: int | None = None

    def __call__(self, done: int, total: int) -> None:
        """Take note of how many units of how many are done."""
        now = time.monotonic()
        if self.before is None:
            # A training that goes on does not begin at 1.
            self.before = max(done - 1, 0)
        if now - self.last < LINE_INTERVAL_S or done == total:
            return
        self.last = now
        each = (now - self.start) / (done - self.before)
        left = f"{each * (total - done) / 60:.0f} min left"
        rate = words_of_rate(1 / each, self.unit)
        tell(f"{self.label}: {done}/{total} {self.unit}, {rate}, {left}")


def words_of_rate(rate: float, unit: str) -> str:
    """Give units per second, or seconds per unit where that reads better."""
    return f"{rate:.1f} {unit}/s" if rate >= 1 else f"{1 / rate:.1f} s/{unit[:-1]}"


def words_of_seconds(seconds: float) -> str:
    """Give a duration in the units that read best: "53 ms", "12.3 s", "12 min 5 s"."""
    if seconds < 1:
        return f"{1000 * seconds:.0f} ms"
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 100:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def _bar(unit: str) -> Bar:
    from rich import console, progress, text

    class RateColumn(progress.ProgressColumn):
        def render(self, task: progress.Task) -> text.Text:
            speed = task.finished_speed or task.speed
            return text.Text(words_of_rate(speed, unit) if speed else "")

    done, left = progress.MofNCompleteColumn(), progress.TimeRemainingColumn()
    columns = ("{task.description}", progress.BarColumn(), done, RateColumn(), left)
    return progress.Progress(*columns, console=console.Console(stderr=True))
