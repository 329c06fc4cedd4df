# SPDX-License-Identifier: MIT
"""Output and exit status: results to stdout, everything else to stderr."""

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

from salsanext_cli.commands.line.options.option_fields import option, option_group
from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.line.options.typer_interface import USAGE_ERROR
from salsanext_cli.commands.line.options.wrong_values import usage_error
from salsanext_cli.commands.line.output.interruption import (
    WORDS,
    end_line,
    interruptible,
    keep_exit_status,
    signal_number,
)
from salsanext_cli.core.errors import SalsanextError, UsageError
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import HINT, escaped, printable
from salsanext_cli.core.wording import spelled

if TYPE_CHECKING:
    from rich.console import RenderableType


# Exit status; 128 + n after signal n
DONE = 0
FAILED = 1
WRONG_USE = 2

SCHEMA = 2  # Version of the JSON; it grows when a key changes or goes
FILE_WIDTH_COLUMNS = 120  # Width of tables in a file or a pipe

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
