# SPDX-License-Identifier: MIT
"""`salsanext export-las`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery


def export_las(
    out: Path = declarations.RESULTS,
    *,
    compressed: bool = option("Write .laz files into laz/.", "--compressed", default=False),
    query: ResultQuery,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write LAS point clouds with classification, labels and all values of every point.

    Example: salsanext export-las out/ --compressed
    """
    from salsanext_cli.commands.stages.export_las import export_las as stage

    with over_results("export-las", running, output.quiet) as options:
        outcome = stage(out, compressed=compressed, query=query, options=options)
    summary.print_summary_and_exit("export-las", outcome, out, output)
