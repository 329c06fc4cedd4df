# SPDX-License-Identifier: MIT
"""Commands on results: fuse, filter, evaluate and export them."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from salsanext_cli.commands.line.options import arguments
from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.options.option_fields import (
    argument,
    names_in,
    option,
    option_group,
)
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import command_on_labels
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery

if TYPE_CHECKING:
    from rich.console import Group

    from salsanext_cli.commands.evaluation import Evaluation
    from salsanext_cli.commands.score_limits import JudgedLimit
    from salsanext_cli.commands.stages.filter import FilterOutcome
    from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
    from salsanext_cli.core.measures.filtered_points import FilteredPoints


def fuse(
    out: Path = arguments.RESULTS,
    target: Path | None = argument(
        "Folder to write the fused labels to.",
        metavar="FUSED",
        show_default="fused, in the folder OUT",
    ),
    *,
    poses: Path | None = option(
        "Poses of the scans of the sequence, from scan to world, in the format of KITTI or TUM.",
        show_default="poses.txt of the sequence, else computed from the scans",
    ),
    reach: FusionReach,
    query: Annotated[ResultQuery, Without({"label_space", "classes"})],
    running: RunOptions,
    output: console.Output,
) -> None:
    """Improve the labels of a drive: scans that overlap vote on each point.

    Example: salsanext fuse out/
    """
    from salsanext_cli.commands.stages.fuse import fuse_results
    from salsanext_cli.runs.results.paths import FUSED

    target = target or out / FUSED
    with over_results("fuse", running, output.quiet) as options:
        outcome = fuse_results(out, target, poses=poses, reach=reach, query=query, options=options)
    following = command_on_labels(outcome, target, query.selection.split)
    summary.print_summary_and_exit("fuse", outcome, target, output, following=following)


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
    output: console.Output,
) -> None:
    """Copy scans or ROS bags without some points, chosen by class or by probability of error.

    Example: salsanext filter out/ static/ --drop moving
    """
    from salsanext_cli.commands.stages.filter import filter_scans

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


def evaluate(
    out: Path = arguments.RESULTS,
    *,
    by_distance: bool = option("Also evaluate by distance from the sensor.", default=False),
    fail_under: str | None = option(
        "Exit with status 1 if a score is below its limit in %, such as "
        "mean_iou=40,iou.person=20; mean_iou is that of the classes present.",
        metavar="LIMITS",
    ),
    fail_over: str | None = option(
        "Exit with status 1 if a score is above its limit in %, such as ece=2; guarantee has the "
        "limit of `tune risk`.",
        metavar="LIMITS",
    ),
    query: ResultQuery,
    running: arguments.ReadOnlyRunOptions,
    output: console.Output,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Scans that the weights were trained on do not count, unless there are no others.

    Example: salsanext eval --split valid
    """
    from salsanext_cli.commands.line.values.limit_options import (
        FAIL_OVER,
        FAIL_UNDER,
        option_of,
        parse_limits,
    )
    from salsanext_cli.commands.stages.evaluate import evaluate as stage

    lower_limits = parse_limits(fail_under, FAIL_UNDER)
    upper_limits = parse_limits(fail_over, FAIL_OVER)
    limits = (*lower_limits, *upper_limits)
    with over_results("eval", running, output.quiet, at_end=True) as options:
        evaluation = stage(
            out, by_distance=by_distance, limits=limits, query=query, options=options
        )
    judged = evaluation.judged_limits(limits)
    missed = [score for score in judged if not score.is_kept]
    names = _names_of_missed(missed, fail_under, fail_over)
    output.result(evaluation.to_dict() | names, _evaluation_tables(evaluation))
    summary.print_failures(evaluation.failures)
    missing = evaluation.missing
    scans = f"{counted(evaluation.counts.scans, 'scan')}{summary.text_of_other_scans(missing)}"
    output.print(f"eval: {scans} → {evaluation.folder}/scores.txt, eval.json, eval_*.png")
    for score in judged:
        text = f"{option_of(score.limit.kind)} {score.text}"
        if score.is_kept:
            output.print(text)
        else:
            console.print_line(f"error: {text}")
    summary.exit_with_status(evaluation.failures, missing, failed=bool(missed))


def _names_of_missed(
    missed: "Sequence[JudgedLimit]", fail_under: str | None, fail_over: str | None
) -> dict[str, list[str]]:
    """Return the names of the missed limits of each option that was given, as keys of JSON."""
    names = {}
    if fail_under is not None:
        names["below"] = [score.name for score in missed if score.limit.kind.higher_is_better]
    if fail_over is not None:
        names["above"] = [score.name for score in missed if not score.limit.kind.higher_is_better]
    return names


def _evaluation_tables(evaluation: "Evaluation") -> "Group":
    """Return the tables and sentences of an evaluation."""
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report import tables

    printed: list[Any] = [tables.score_table(evaluation.scores, evaluation.doubt)]
    if evaluation.by_distance:
        printed.append(tables.band_table(evaluation.by_distance))
    printed += tables.uncertainty_tables(evaluation.uncertainty)
    if evaluation.uncertainty.accepted:
        printed.append(Text(evaluation.uncertainty.accepted.sentence))
    if evaluation.accepted:
        printed.append(tables.accepted_table(evaluation.accepted.classes))
        printed.append(Text("\n".join(_rejection_sentences(evaluation, evaluation.accepted))))
    return Group(*printed)


def _rejection_sentences(evaluation: "Evaluation", accepted: "AcceptedLabels") -> list[str]:
    """Return the sentences about the accepted labels of a run that rejected others."""
    threshold = evaluation.settings["reject"]
    counting = (
        f"Points rejected by `predict --reject` (threshold {threshold:.4g}) count as wrong in "
        "accuracy and IoU, and do not count in the official accuracy."
    )
    sentences = [counting, *accepted.sentences]
    if evaluation.guarantee:
        sentences.append(evaluation.guarantee.sentence)
    return sentences


def export_ply(
    out: Path = arguments.RESULTS,
    *,
    colour: str = option(f"{arguments.COLOUR_HELP}.", "--colour", "--color", default="label"),
    scale: tuple[float, float] | None = arguments.SCALE,
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


def export_las(
    out: Path = arguments.RESULTS,
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
