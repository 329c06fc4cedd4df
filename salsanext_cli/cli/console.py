# SPDX-License-Identifier: MIT
"""Output, progress and exit status: results to stdout, everything else to stderr."""

import dataclasses
import functools
import json
import logging
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, ParamSpec, cast

import typer

from salsanext_cli.cli.interruption import end_line, interruptible
from salsanext_cli.errors import NOTICE, SalsanextError, UsageError, escaped, printable
from salsanext_cli.option_fields import option, option_group

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress as Bar

    from salsanext_cli.parallel.run_options import Progress, RunOptions

DONE, FAILED, WRONG_USE = 0, 1, 2
"""Exit status: all done, something failed, the command line was wrong; 128 + n after signal n."""

SCHEMA = 2  # Version of what `--json` prints; it grows when a key changes or goes
USAGE_ERROR = cast("type[Exception]", typer.BadParameter.__base__)
"""Errors of the command line, of which typer names only one kind."""
FILE_WIDTH_COLUMNS = 120

Parameters = ParamSpec("Parameters")
output_option = partial(option, "Output")


@option_group
class Output:
    """Amount and form of what a command prints."""

    json: bool = output_option("Print one JSON object on stdout.", default=False)
    verbose: bool = output_option(
        "Print more messages on stderr.", "--verbose", "-v", default=False
    )
    quiet: bool = output_option("Print errors only.", "--quiet", "-q", default=False)
    start: float = dataclasses.field(init=False, default_factory=time.monotonic, compare=False)

    def __post_init__(self) -> None:
        if self.verbose and self.quiet:
            raise UsageError("--verbose and --quiet", "both given", "one of them")
        level = logging.INFO if self.verbose else logging.ERROR if self.quiet else NOTICE
        logger = logging.getLogger("salsanext_cli")
        logger.handlers[:] = [StderrHandler()]
        logger.setLevel(level)

    def say(self, text: str) -> None:
        """Tell the user something, on stderr."""
        if not self.quiet:
            tell(printable(text))

    @property
    def seconds(self) -> float:
        """Time since the command began."""
        return time.monotonic() - self.start

    def result(self, data: Mapping[str, object], shown: "RenderableType | None" = None) -> None:
        """Give the result: JSON if asked for, else what is to be shown, on stdout."""
        if self.json:
            _print_json({**data, "seconds": round(self.seconds, 3)})
        elif shown is not None:
            from rich.console import Console

            width = None if sys.stdout.isatty() else FILE_WIDTH_COLUMNS
            Console(file=sys.stdout, highlight=False, width=width).print(shown)


class StderrHandler(logging.Handler):
    """Handler that shows what the library logs as the command line shows its own errors."""

    def emit(self, record: logging.LogRecord) -> None:
        """Write one line."""
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        tell(printable(f"{level}{record.getMessage()}"))


def guarded(command: Callable[Parameters, None]) -> Callable[Parameters, None]:
    """Turn a user's mistake into one line and an exit status; let bugs keep their traceback."""

    @functools.wraps(command)
    def run(*args: Parameters.args, **kwargs: Parameters.kwargs) -> None:
        try:
            with interruptible():
                command(*args, **kwargs)
        except SalsanextError as error:
            if not error.reported_elsewhere:
                tell(f"error: {error}")
                if kwargs.get("json"):
                    found = {"error": error.headline, "hint": error.hint, "code": error.code}
                    _print_json(found)
            raise typer.Exit(WRONG_USE if isinstance(error, UsageError) else FAILED) from None
        except KeyboardInterrupt:
            line, status = end_line()
            tell(line)
            if kwargs.get("json"):
                word = line.partition(":")[0]
                _print_json({"error": word, "code": word})
            raise typer.Exit(status) from None

    return run


@contextmanager
def usage_errors(arguments: Sequence[str]) -> Iterator[None]:
    """Print an error of the command line, which typer explains on stderr, as JSON if asked for."""
    try:
        yield
    except USAGE_ERROR as error:
        if "--json" in arguments:
            message: Any = error
            _print_json({"error": message.format_message(), "code": UsageError.code})
        raise


def _print_json(data: Mapping[str, object]) -> None:
    from salsanext_cli.files.json_files import plain

    # ASCII, since stdout may be no UTF-8.
    typer.echo(json.dumps({"schema": SCHEMA} | escaped(plain(data)), allow_nan=False))


LINE_INTERVAL_S = 30.0  # Time between two lines in a log file


def tell(text: str) -> None:
    """Write a line on stderr, or through rich's stand-in for it, above the bar if there is one."""
    sys.stderr.write(f"{text}\n")


@contextmanager
def progress(label: str, quiet: bool, unit: str = "scans") -> Iterator["Progress | None"]:
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
def over_scans(label: str, options: "RunOptions", quiet: bool) -> Iterator["RunOptions"]:
    """Show the progress of a run over scans while the body runs with the options it gets."""
    with progress(label, quiet) as bar:
        yield dataclasses.replace(options, progress=bar)


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
            self.before = max(done - 1, 0)  # A training that goes on does not begin at 1.
        if now - self.last < LINE_INTERVAL_S or done == total:
            return
        self.last = now
        each = (now - self.start) / (done - self.before)
        left = f"{each * (total - done) / 60:.0f} min left"
        rate = rate_text(1 / each, self.unit)
        tell(f"{self.label}: {done}/{total} {self.unit}, {rate}, {left}")


def rate_text(rate: float, unit: str) -> str:
    """Give units per second, or seconds per unit where that reads better."""
    return f"{rate:.1f} {unit}/s" if rate >= 1 else f"{1 / rate:.1f} s/{unit[:-1]}"


def duration_text(seconds: float) -> str:
    """Give a duration in the units that read best: "53 ms", "12.3 s", "12 min 5 s"."""
    if seconds < 1:
        return f"{1000 * seconds:.0f} ms"
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 100:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"


def _bar(unit: str) -> "Bar":
    from rich import console, progress, text

    class RateColumn(progress.ProgressColumn):
        def render(self, task: progress.Task) -> text.Text:
            speed = task.finished_speed or task.speed
            return text.Text(rate_text(speed, unit) if speed else "")

    done, left = progress.MofNCompleteColumn(), progress.TimeRemainingColumn()
    columns = ("{task.description}", progress.BarColumn(), done, RateColumn(), left)
    return progress.Progress(*columns, console=console.Console(stderr=True))
