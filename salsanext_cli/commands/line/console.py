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
from typing import TYPE_CHECKING, ParamSpec, TextIO

import typer

from salsanext_cli.commands.line.interruption import (
    NO_HALF_FILES,
    WORDS,
    end_line,
    interruptible,
    keep_exit_status,
    on_interruption,
    signal_number,
)
from salsanext_cli.commands.line.option_fields import option, option_group
from salsanext_cli.commands.line.option_names import CommandLine
from salsanext_cli.commands.line.typer_interface import USAGE_ERROR
from salsanext_cli.commands.line.wrong_values import usage_error
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.notices import NOTICE, files_known
from salsanext_cli.core.texts import HINT, escaped, printable
from salsanext_cli.core.wording import spelled

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.progress import Progress as Bar

    from salsanext_cli.runs.loop.run_options import Progress, RunOptions

# Exit status; 128 + n after signal n
DONE = 0
FAILED = 1
WRONG_USE = 2

SCHEMA = 2  # Version of the JSON; it grows when a key changes or goes
FILE_WIDTH_COLUMNS = 120  # Width of tables in a file or a pipe
LINE_INTERVAL_S = 30.0  # Time between two lines of progress in a log file

Parameters = ParamSpec("Parameters")
output_option = partial(option, panel="Output", default=False)


@option_group
class Output:
    """Amount and form of the output of a command."""

    json: bool = output_option("Print the results as one JSON object.")
    verbose: bool = output_option("Print more messages.", "--verbose", "-v")
    quiet: bool = output_option("Print errors only.", "--quiet", "-q")
    start: float = dataclasses.field(init=False, default_factory=time.monotonic, compare=False)

    def print(self, text: str) -> None:
        """Print a message on stderr, unless the command is quiet."""
        if not self.quiet:
            print_line(printable(text))

    @property
    def seconds(self) -> float:
        """Time since the command began, in seconds."""
        return time.monotonic() - self.start

    def result(self, data: Mapping[str, object], tables: "RenderableType | None" = None) -> None:
        """Print the result on stdout: as JSON with `--json`, else the tables."""
        if self.json:
            _print_json({**data, "seconds": round(self.seconds, 3)})
        elif tables is not None:
            _print_tables(tables, sys.stdout)

    def explain(self, tables: "RenderableType") -> None:
        """Print tables that explain an error on stderr, unless the command is quiet."""
        if not self.quiet:
            _print_tables(tables, sys.stderr)


def _print_tables(tables: "RenderableType", file: TextIO) -> None:
    """Print tables as wide as the terminal, or as `FILE_WIDTH_COLUMNS`."""
    from rich.console import Console

    width = None if file.isatty() else FILE_WIDTH_COLUMNS
    Console(file=file, highlight=False, width=width).print(tables)


def log_to_stderr(*, verbose: bool = False, quiet: bool = False) -> None:
    """Print the messages of the package on stderr from now on, more of them or errors only."""
    level = NOTICE
    if verbose:
        level = logging.INFO
    elif quiet:
        level = logging.ERROR
    logger = logging.getLogger("salsanext_cli")
    logger.handlers[:] = [StderrHandler()]
    logger.setLevel(level)


class StderrHandler(logging.Handler):
    """Handler that prints log records in the form of errors."""

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record."""
        level = "" if record.levelno < logging.WARNING else f"{record.levelname.lower()}: "
        headline, mark, hint = f"{level}{record.getMessage()}".partition(HINT)
        print_line(f"{printable(headline)}{mark}{printable(hint)}")


def guarded(command: Callable[Parameters, None]) -> Callable[Parameters, None]:
    """Print a mistake of the user and exit with a status; let bugs keep their traceback.

    Messages name options while the command runs, and are printed on stderr. The values of
    ``--json``, ``--verbose`` and ``--quiet`` decide about them before any other option is read.
    """

    @functools.wraps(command)
    def run(*args: Parameters.args, **kwargs: Parameters.kwargs) -> None:
        as_json = bool(kwargs.get("json"))
        verbose = bool(kwargs.get("verbose"))
        quiet = bool(kwargs.get("quiet"))
        try:
            with interruptible(), spelled(CommandLine()):
                if verbose and quiet:
                    raise UsageError("--verbose and --quiet", "both were given", "one of them")
                log_to_stderr(verbose=verbose, quiet=quiet)
                command(*args, **kwargs)
        except SalsanextError as error:
            if not error.reported_elsewhere:
                _print_error(error, as_json=as_json)
            raise typer.Exit(WRONG_USE if isinstance(error, UsageError) else FAILED) from None
        except KeyboardInterrupt:
            keep_exit_status()
            print_line(end_line())
            number = signal_number()
            if as_json:
                word = WORDS[number]
                _print_json({"error": word, "hint": "", "code": word})
            raise typer.Exit(128 + number) from None

    return run


@contextmanager
def usage_errors(arguments: Sequence[str]) -> Iterator[None]:
    """Print an error of typer about the command line like every other error."""
    try:
        yield
    except USAGE_ERROR as error:
        _print_error(usage_error(error, arguments), as_json="--json" in arguments)
        raise typer.Exit(WRONG_USE) from None


def _print_error(error: SalsanextError, *, as_json: bool) -> None:
    print_line(f"error: {error}")
    if as_json:
        _print_json({"error": error.headline, "hint": error.hint, "code": error.code})


def _print_json(data: Mapping[str, object]) -> None:
    from salsanext_cli.core.plain_data import plain

    # ASCII, since stdout may be no UTF-8.
    typer.echo(json.dumps({"schema": SCHEMA} | escaped(plain(data)), allow_nan=False))


def print_line(text: str) -> None:
    """Print a line on stderr, above the progress bar if there is one."""
    sys.stderr.write(f"{text}\n")


@contextmanager
def progress(label: str, quiet: bool, unit: str = "scans") -> Iterator["Progress | None"]:
    """Show the progress of the body on stderr: units done, rate and time left."""
    if quiet:
        yield None
    elif sys.stderr.isatty():
        with _bar(unit) as bar:
            task = bar.add_task(label, total=None)
            yield lambda done, total: bar.update(task, completed=done, total=total)
    else:
        yield Lines(label, unit)


@dataclasses.dataclass(slots=True, eq=False, kw_only=True)
class Written:
    """Progress of a body that writes the results of each unit, or all of them at its end."""

    unit: str  # Plural, such as "scans"
    at_end: bool
    show: "Progress | None"  # Shows the progress, if anything does
    done: int = 0  # Number of finished units
    total: int = 0  # Number of all units

    def __call__(self, done: int, total: int) -> None:
        """Note and show the number of finished units and of all."""
        self.done = done
        self.total = total
        if self.show:
            self.show(done, total)

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
    with progress(label, quiet, unit) as bar:
        written = Written(unit=unit, at_end=at_end, show=bar)
        with on_interruption(written.finished):
            yield written


@contextmanager
def over_scans(
    label: str, options: "RunOptions", quiet: bool, *, at_end: bool = False
) -> Iterator["RunOptions"]:
    """Show the progress of a run over scans, which takes the options of the context.

    `at_end`: whether it writes its results at the end, and not those of each scan.
    """
    with writing(label, quiet, at_end=at_end) as bar:
        yield dataclasses.replace(options, progress=bar)


@contextmanager
def over_results(
    label: str, options: "RunOptions", quiet: bool, *, at_end: bool = False
) -> Iterator["RunOptions"]:
    """Do what `over_scans` does for scans that an earlier command has read.

    That command has printed what readers assume about their files.
    """
    with files_known(), over_scans(label, options, quiet, at_end=at_end) as running:
        yield running


@dataclasses.dataclass(frozen=True, slots=True)
class Reached:
    """Number of units that were done at a time."""

    done: int
    time: float  # Seconds of a clock


class Lines:
    """Progress as lines of text, at most one in `LINE_INTERVAL_S` of a clock in seconds.

    The rate is measured from the first finished unit on, because that one includes the time to
    load and compile the network.
    """

    def __init__(self, label: str, unit: str, clock: Callable[[], float] = time.monotonic) -> None:
        self.label = label
        self.unit = unit
        self.clock = clock
        self.last = clock()
        self.first: Reached | None = None

    def __call__(self, done: int, total: int) -> None:
        """Print a line if one is due."""
        if not done:
            return
        now = self.clock()
        if self.first is None:
            self.first = Reached(done, now)
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
    from rich import console, progress, text

    class RateColumn(progress.ProgressColumn):
        def render(self, task: progress.Task) -> text.Text:
            speed = task.finished_speed or task.speed
            return text.Text(rate_text(speed, unit) if speed else "")

    return progress.Progress(
        "{task.description}",
        progress.BarColumn(),
        progress.MofNCompleteColumn(),
        RateColumn(),
        progress.TimeElapsedColumn(),
        progress.TimeRemainingColumn(),
        console=console.Console(stderr=True),
    )
