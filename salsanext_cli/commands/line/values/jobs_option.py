# SPDX-License-Identifier: MIT
"""`--jobs` of `predict`, which chooses the number of workers on a GPU by itself."""

from typing import Annotated

from salsanext_cli.commands.line.options.expansion import Declared
from salsanext_cli.commands.line.options.option_fields import DeclarationChange
from salsanext_cli.core.errors import UsageError
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.sensor_request import AUTO

OPTION = "--jobs"


def typed_jobs(text: str | None) -> int | None:
    """Read a number of workers; ``auto``, or no text, is None."""
    if text is None or text == AUTO:
        return None
    try:
        return int(text)
    except ValueError as error:
        expected = f"a number of workers, -1 for all cores, or {AUTO}"
        hint = "see salsanext predict --help"
        raise UsageError(OPTION, repr(text), expected, hint) from error


MeasuredRunOptions = Annotated[
    RunOptions,
    Declared(
        jobs=DeclarationChange(
            help="Number of processes; -1: one per core.",
            metavar=f"{AUTO}|N",
            show_default=AUTO,
            parse=typed_jobs,
        )
    ),
]
"""Options of a run of `predict`."""
