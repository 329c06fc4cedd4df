# SPDX-License-Identifier: MIT
"""Value of `--cluster`: what is typed counts, and then the variable."""

from typing import Any

from salsanext_cli.commands.line.options.typer_interface import is_typed
from salsanext_cli.commands.line.output.console import guarded
from salsanext_cli.core.errors import UsageError


@guarded
def choose_workers(context: Any, *, json: bool) -> None:
    """Let `--jobs` win over the variable of `--cluster`; `guarded` reads `json`.

    Parameters
    ----------
    context : typer.Context
        Parsed command line, whose parameters are changed.
    json : bool
        Whether an error is printed as JSON.

    Raises
    ------
    UsageError
        If both were typed.
    """
    if not (is_typed(context, "jobs") and context.params.get("cluster")):
        return
    if is_typed(context, "cluster"):
        raise UsageError("--jobs and --cluster", "both were given", "one of them")
    context.params["cluster"] = None
