# SPDX-License-Identifier: MIT
"""`salsanext export-ply`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery


def export_ply(
    out: Path = declarations.RESULTS,
    *,
    colour: str = option(f"{declarations.COLOUR_HELP}.", "--colour", "--color", default="label"),
    scale: tuple[float, float] | None = declarations.SCALE,
    query: ResultQuery,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write coloured point clouds that contain all values of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.commands.stages.export_ply import export_ply as stage

    with over_results("export-ply", running, output.quiet) as options:
        outcome = stage(out, colour=colour, scale=scale, query=query, options=options)
    summary.print_summary_and_exit("export-ply", outcome, out, output)
