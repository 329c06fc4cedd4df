# SPDX-License-Identifier: MIT
"""Commands on results: fuse, filter, evaluate and export them."""

from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from salsanext_cli.cli import arguments, console, summary
from salsanext_cli.cli.console import over_scans
from salsanext_cli.cli.expansion import Without
from salsanext_cli.errors import counted
from salsanext_cli.option_fields import FusionReach, argument, names_in, option, option_group
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.uncertainty_kinds import COLOUR_HELP

if TYPE_CHECKING:
    from rich.console import Group

    from salsanext_cli.stages.evaluate import Evaluation


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
    from salsanext_cli.stages.fuse import FUSED, fuse_results

    target = target or out / FUSED
    with over_scans("fuse", running, output.quiet) as run:
        outcome = fuse_results(out, target, poses=poses, reach=reach, query=query, options=run)
    summary.finish("fuse", outcome, target, output, split=query.selection.split)


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
    max_error: float | None = option("Drop points whose probability of error is above this.")


def filter_command(
    out: Path = argument(
        "Folder with the results of earlier commands.", default=..., metavar="OUT"
    ),
    target: Path = argument("New folder to write the scans to.", default=..., metavar="TARGET"),
    *,
    points: PointChoice,
    query: Annotated[ResultQuery, Without({"split", "label_space", "classes"})],
    running: RunOptions,
    output: console.Output,
) -> None:
    """Copy the scans without some points, chosen by class or by probability of error.

    Example: salsanext filter out/ static/ --drop moving
    """
    from salsanext_cli.stages.filter import filter_scans

    with over_scans("filter", running, output.quiet) as run:
        outcome = filter_scans(out, target, **asdict(points), query=query, options=run)
    summary.finish("filter", outcome, target, output)


def evaluate(
    out: Path = arguments.RESULTS,
    *,
    by_distance: bool = option("Also evaluate by distance from the sensor.", default=False),
    fail_under: str | None = option(
        "Exit with status 1 if a score is below its limit in %, such as mean_iou=40,accuracy=80; "
        "mean_iou is that of the classes present.",
        metavar="LIMITS",
    ),
    query: ResultQuery,
    running: arguments.Reading,
    output: console.Output,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Scans that the weights were trained on do not count, unless there are no others.

    Example: salsanext eval --split valid
    """
    from salsanext_cli.measures.score_limits import limits_of, scores_below
    from salsanext_cli.results.result_folder import ResultFolder
    from salsanext_cli.stages.evaluate import evaluate as stage
    from salsanext_cli.stages.evaluate import part_of

    limits = limits_of(fail_under)
    folder = ResultFolder(out, query.dataset)
    unlimited = replace(query.selection, limit=None)
    chosen, space = folder.predicted(unlimited, query.label_space, query.classes)
    part = part_of(folder, chosen, query.selection)
    files = chosen[: query.selection.limit]
    with over_scans("eval", running, output.quiet) as run:
        settings, labels = folder.provenance(query.selection), query.label_space
        evaluation = stage(
            files, out, space, run, part, by_distance=by_distance, settings=settings, labels=labels
        )
    below = scores_below(limits, evaluation.scores)
    limited = {} if fail_under is None else {"below": [low.name for low in below]}
    output.result(evaluation.to_dict() | limited, _evaluation_tables(evaluation))
    summary.print_failures(evaluation.failures)
    missing = evaluation.missing
    scans = f"{counted(evaluation.counts.scans, 'scan')}{summary.skipped_text(missing)}"
    output.print(f"eval: {scans} → {evaluation.folder}/scores.txt, eval.json, eval_*.png")
    for low in below:
        console.print_line(f"error: {low.text}")
    summary.leave(evaluation.failures, missing, failed=bool(below))


def _evaluation_tables(evaluation: "Evaluation") -> "Group":
    """Return the tables and sentences of an evaluation."""
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report import tables

    uncertainty, accepted = evaluation.uncertainty, evaluation.accepted
    parts: list[Any] = [tables.score_table(evaluation.scores, evaluation.doubt)]
    parts += [tables.band_table(evaluation.by_distance)] if evaluation.by_distance else []
    parts += tables.uncertainty_tables(uncertainty)
    parts += [Text(uncertainty.accepted.sentence)] if uncertainty.accepted else []
    if accepted:
        threshold = evaluation.settings["reject"]
        missed = (
            f"Points rejected by `predict --reject` (threshold {threshold:.4g}) count as wrong in "
            "accuracy and IoU, and do not count in the official accuracy."
        )
        guarantee = [evaluation.guarantee.sentence] if evaluation.guarantee else []
        lines = [missed, *accepted.sentences, *guarantee]
        parts += [tables.accepted_table(accepted.classes), Text("\n".join(lines))]
    return Group(*parts)


def export_ply(
    out: Path = arguments.RESULTS,
    *,
    colour: str = option(f"{COLOUR_HELP}.", "--colour", "--color", default="label"),
    scale: tuple[float, float] | None = arguments.SCALE,
    query: ResultQuery,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write coloured point clouds that contain all values of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.stages.export_ply import export_ply as stage

    with over_scans("export-ply", running, output.quiet) as run:
        outcome = stage(out, colour=colour, scale=scale, query=query, options=run)
    summary.finish("export-ply", outcome, out, output)
