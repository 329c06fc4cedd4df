# SPDX-License-Identifier: MIT
"""`salsanext export-bag`."""

from pathlib import Path
from typing import Annotated

from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery


def export_bag(
    out: Path = argument("Folder with the labels of clouds of a bag.", default=..., metavar="OUT"),
    target: Path = argument("New folder to write the bags to.", default=..., metavar="TARGET"),
    *,
    topic: str | None = option(
        "Topic of the labelled clouds.", metavar="NAME", show_default="TOPIC/labelled"
    ),
    query: Annotated[ResultQuery, Without({"split", "limit"})],
    running: Annotated[RunOptions, Without({"jobs", "cluster"})],
    output: console.Output,
) -> None:
    """Copy ROS bags with a new topic of the clouds and their labels, errors and colours.

    Example: salsanext export-bag out/ labelled/
    """
    from salsanext_cli.commands.stages.export_bag import export_bag as stage

    with over_results("export-bag", running, output.quiet) as run:
        outcome = stage(out, target, topic=topic, query=query, options=run)
    summary.print_summary_and_exit("export-bag", outcome, target, output)
