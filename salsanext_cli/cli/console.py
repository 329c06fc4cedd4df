# SPDX-License-Identifier: MIT
"""Output and exit status of commands: results to stdout, everything else to stderr."""

from __future__ import annotations

import functools
import json
import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any, NoReturn, ParamSpec

import typer

from salsanext_cli.cli.option_groups import option, option_group
from salsanext_cli.cli.progress import tell
from salsanext_cli.errors import NOTICE, SalsanextError, UsageError, printable

if TYPE_CHECKING:
    from rich.console import RenderableType

    from salsanext_cli.parallel.run import Failure, Outcome
    from salsanext_cli.storage.sources import MissingResults

DONE, FAILED, WRONG_USE, INTERRUPTED, TERMINATED = 0, 1, 2, 130, 143
"""Exit status: all done, something failed, the command line was wrong, Ctrl-C, SIGTERM."""

FILE_WIDTH_COLUMNS = 120
"""Width of a table that does not go to a terminal."""

Parameters = ParamSpec("Parameters")
output_option = partial(option, "Output")


@option_group
class Output:
    """Amount and form of what a command prints."""

    json: bool = output_option("Print one JSON object on stdout.", "--json", default=False)
    verbose: bool = output_option(
        "Print more messages on stderr.", "--verbose", "-v", default=False
    )
    quiet: bool = output_option("Print errors only.", "--quiet", "-q", default=False)

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

    def result(self, data: Mapping[str, Any], shown: RenderableType | None = None) -> None:
        """Give the result: JSON if asked for, else what is to be shown, on stdout."""
        if self.json:
            # ASCII, since names of files may be no text, and stdout no UTF-8.
            typer.echo(json.dumps(data, allow_nan=False))
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


class Terminated(KeyboardInterrupt):
    """SIGTERM: what stops at Ctrl-C stops at that too."""


def guarded(command: Callable[Parameters, None]) -> Callable[Parameters, None]:
    """Turn a user's mistake into one line and an exit status; let bugs keep their traceback."""

    @functools.wraps(command)
    def run(*args: Parameters.args, **kwargs: Parameters.kwargs) -> None:
        try:
            with _sigterm_raised():
                command(*args, **kwargs)
        except SalsanextError as error:
            if not error.reported_elsewhere:
                tell(f"error: {error}")
                if kwargs.get("json"):
                    typer.echo(json.dumps({"error": str(error)}))
            raise typer.Exit(WRONG_USE if isinstance(error, UsageError) else FAILED) from None
        except Terminated:
            tell("terminated: everything finished so far is intact")
            raise typer.Exit(TERMINATED) from None
        except KeyboardInterrupt:
            tell("interrupted: everything finished so far is intact")
            raise typer.Exit(INTERRUPTED) from None

    return run


@contextmanager
def _sigterm_raised() -> Iterator[None]:
    """Raise `Terminated` at SIGTERM while the body runs, unless the program handles it itself."""
    mine = os.getpid()

    def handle(number: int, _: object) -> NoReturn:
        if os.getpid() != mine:
            # A child made by fork ends at once, as it would have without this handler.
            os._exit(128 + number)
        raise Terminated

    in_main_thread = threading.current_thread() is threading.main_thread()
    if not in_main_thread or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def name_failures(failures: tuple[Failure, ...]) -> None:
    """Name every scan that failed, on stderr."""
    for failure in failures:
        tell(f"error: {failure.reason}")


def finish(stage: str, outcome: Outcome, out: object, output: Output) -> NoReturn:
    """Say what became of a run over scans and leave with the exit status for it."""
    missing = outcome.missing
    name_failures(outcome.failures)
    counts = {"done": outcome.done, "skipped": outcome.skipped, "failed": len(outcome.failures)}
    failures = [{"scan": str(f.scan.path), "reason": f.reason} for f in outcome.failures]
    found: dict[str, Any] = {"stage": stage, **counts, "out": str(out), "failures": failures}
    if missing:
        found["missing"] = [str(scan.path) for scan in missing.scans]
        found["not_asked_for"] = missing.not_asked_for
    output.result(found)
    already = f", {outcome.skipped} done already" if outcome.skipped else ""
    failed = f", {len(outcome.failures)} failed" if outcome.failures else ""
    others = left_out(missing, "results") if missing else ""
    output.say(f"{stage}: {outcome.done} scans{already}{failed}{others} → {out}")
    leave(outcome.failures, missing)


def leave(failures: tuple[Failure, ...], missing: MissingResults | None = None) -> NoReturn:
    """Leave with the exit status for scans that failed or lack results."""
    raise typer.Exit(FAILED if failures or (missing and missing.scans) else DONE)


def left_out(missing: MissingResults, what: str) -> str:
    """Return the part of a sentence that says how many scans were left out on purpose."""
    count = missing.not_asked_for
    return f", {count} not asked for have no {what}" if count else ""
