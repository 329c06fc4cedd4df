# SPDX-License-Identifier: MIT
"""`salsanext compare`."""

from pathlib import Path

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.results.query import ResultQuery


def compare(
    context: typer.Context,
    before: Path = argument("Results of the first run.", default=..., metavar="OUT"),
    after: Path = argument(
        "Results of another run on the same scans; several may be given.",
        default=...,
        metavar="OUT...",
    ),
    *,
    query: ResultQuery,
    running: declarations.ReadOnlyRunOptions,
    output: console.Output,
) -> None:
    """Compare runs on the same scans: scores, and whether a change is clear; changed labels.

    Each run is compared with the first. Scans need no labels.

    Example: salsanext compare out/ tuned/
    """
    from rich.console import Group

    from salsanext_cli.commands.stages.compare import compare as stage
    from salsanext_cli.report.run_change_tables import comparison_tables
    from salsanext_cli.runs.summary.run_comparison import FILES

    others = [after, *map(Path, context.args)]
    outcomes = []
    for other in others:
        with over_results("compare", running, output.quiet, at_end=True) as options:
            outcomes.append(stage(before, other, query=query, options=options))
    failures = tuple(failure for outcome in outcomes for failure in outcome.failures)
    data = {
        "stage": "compare",
        "comparisons": [outcome.comparison for outcome in outcomes],
        "failures": [failure.to_dict() for failure in failures],
    }
    tables = [comparison_tables(outcome.comparison) for outcome in outcomes]
    output.result(data, Group(*tables))
    summary.print_failures(failures)
    for other, outcome in zip(others, outcomes, strict=True):
        scans = counted(outcome.comparison.scans, "scan")
        other_scans = summary.text_of_other_scans(outcome.missing)
        output.print(f"compare: {scans}{other_scans} → {other}/{', '.join(FILES)}")
    are_missing = any(outcome.missing.scans for outcome in outcomes)
    summary.exit_with_status(failures, failed=are_missing)
