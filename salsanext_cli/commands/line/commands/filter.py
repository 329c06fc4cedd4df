# SPDX-License-Identifier: MIT
"""`salsanext filter`."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.options.option_fields import (
    argument,
    names_in,
    option,
    option_group,
)
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.core.notices import demote_reader_notices
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery

if TYPE_CHECKING:
    from salsanext_cli.commands.stages.filter import FilterOutcome
    from salsanext_cli.core.measures.filtered_points import FilteredPoints


@option_group
class PointChoice:
    """Choice of the points that `filter` writes."""

    drop: tuple[str, ...] = option(
        "Drop these classes, such as person,vehicle; moving: all movable classes, your own "
        "vehicle, and points without a measurement.",
        parse=partial(names_in, option="--drop", example="car,person"),
        metavar="CLASSES",
    )
    keep: tuple[str, ...] = option(
        "Write these classes only.",
        parse=partial(names_in, option="--keep", example="car,person"),
        metavar="CLASSES",
    )
    max_error: float | None = option(
        "Drop points whose probability of error is above this, and points without one."
    )


def filter_command(
    out: Path = argument(
        "Folder with the results of earlier commands.", default=..., metavar="OUT"
    ),
    target: Path = argument(
        "New folder to write the scans or bags to.", default=..., metavar="TARGET"
    ),
    *,
    points: PointChoice,
    query: Annotated[ResultQuery, Without({"split", "label_space", "classes"})],
    running: RunOptions,
    dry_run: bool = declarations.DRY_RUN,
    output: console.Output,
) -> None:
    """Copy scans or ROS bags without some points, chosen by class or by probability of error.

    Example: salsanext filter out/ static/ --drop moving
    """
    from salsanext_cli.commands.stages.filter import filter_scans, plan_filter

    if dry_run:
        with demote_reader_notices():
            plan = plan_filter(
                out,
                target,
                drop=points.drop,
                keep=points.keep,
                max_error=points.max_error,
                query=query,
                options=running,
            )
        print_plan("filter", plan, target, output)
        return
    with over_results("filter", running, output.quiet) as options:
        outcome = filter_scans(
            out,
            target,
            drop=points.drop,
            keep=points.keep,
            max_error=points.max_error,
            query=query,
            options=options,
        )
    summary.print_summary_and_exit(
        "filter", outcome, target, output, numbers=_filter_numbers(outcome)
    )


def _filter_numbers(outcome: "FilterOutcome") -> summary.StageNumbers:
    """Return the numbers of filtered points, with a line about them if a scan was filtered."""
    points = outcome.filtered_points
    data = {
        "points": points.points,
        "accepted_points": points.remaining,
        "accepted_without_label": points.rejected,
        "points_without_error": points.without_error,
    }
    lines = [_filter_line(points)] if outcome.done else []
    return summary.StageNumbers(data=data, lines=lines)


def _filter_line(points: "FilteredPoints") -> str:
    """Return the line about filtered points."""
    line = f"{points.remaining:,} of {counted(points.points, 'point')} remain"
    if not points.without_error:
        return line
    number = counted(points.without_error, "point")
    cause = "on the housing or the vehicle, not measured, or outside the image"
    return f"{line}; {number} dropped without a probability of error ({cause})"
