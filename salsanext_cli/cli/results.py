# SPDX-License-Identifier: MIT
"""Commands that work on results: they fuse, filter, compare, evaluate and export them."""

from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from salsanext_cli.cli import arguments, console, summary
from salsanext_cli.cli.console import over_scans
from salsanext_cli.cli.expansion import Without
from salsanext_cli.errors import UsageError, counted
from salsanext_cli.option_fields import FusionReach, names_in, option_group, own_option
from salsanext_cli.parallel.run_options import RunOptions
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.uncertainty_kinds import COLOUR_HELP

if TYPE_CHECKING:
    from rich.console import Group

    from salsanext_cli.stages.evaluate import Evaluation


def fuse(
    out: arguments.Out = Path("out"),
    target: Annotated[
        Path | None,
        typer.Argument(
            metavar="TARGET", help="Folder for the fused labels.", show_default="OUT/fused"
        ),
    ] = None,
    *,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Poses of the scans of the sequence, from scan to world, as KITTI or TUM have "
            "them.",
            show_default="poses.txt in its folder, else computed from the scans",
        ),
    ] = None,
    reach: FusionReach,
    query: Annotated[ResultQuery, Without({"label_space", "classes"})],
    running: RunOptions,
    strict: arguments.Strict = False,
    output: console.Output,
) -> None:
    """Correct the labels of each scan of a drive by all scans that see the same places.

    Example: salsanext fuse out/
    """
    from salsanext_cli.stages.fuse import FUSED, fuse_results

    target = target or out / FUSED
    with over_scans("fuse", running, output.quiet) as run:
        outcome = fuse_results(out, target, poses=poses, reach=reach, query=query, options=run)
    summary.finish("fuse", outcome, target, output, split=query.selection.split, strict=strict)


@option_group
class PointChoice:
    """Choice of the points that `filter` writes."""

    drop: tuple[str, ...] = own_option(
        "Leave out these classes, such as person,vehicle; coarse names too, and moving for all "
        "movable ones, with the sensor's own vehicle and points without a measurement.",
        parse=partial(names_in, option="--drop", example="car,person"),
    )
    keep: tuple[str, ...] = own_option(
        "Keep these classes only.",
        parse=partial(names_in, option="--keep", example="car,person"),
        show_default="all",
    )
    max_error: float | None = own_option("Leave out points whose error is above this, 0 to 1.")
    split: bool = own_option("Write a file for each class.", default=False)
    indices: bool = own_option("Write masks of the points that stay (.npy).", default=False)


def filter_command(
    out: arguments.Out = Path("out"),
    *,
    to: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder to write.")],
    points: PointChoice,
    query: Annotated[ResultQuery, Without({"split", "label_space", "classes"})],
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write the scans in their own format without some of their points, by class or error.

    Example: salsanext filter out/ --drop moving --to static/
    """
    from salsanext_cli.stages.filter import filter_scans

    with over_scans("filter", running, output.quiet) as run:
        outcome = filter_scans(out, to, **asdict(points), query=query, options=run)
    summary.finish("filter", outcome, to, output)


def compare(
    before: Annotated[Path, typer.Argument(metavar="OUT_A", help="Results of the first run.")],
    after: Annotated[Path, typer.Argument(metavar="OUT_B", help="Results of the second run.")],
    *,
    query: ResultQuery,
    running: arguments.Reading,
    output: console.Output,
) -> None:
    """Compare two runs on the same scans: what changed, and whether it is better.

    Scans that the weights of a run were trained on are left out of the scores.

    Example: salsanext compare out/ tuned/
    """
    from salsanext_cli.report.comparison import comparison_tables
    from salsanext_cli.stages.compare import RECORD
    from salsanext_cli.stages.compare import compare as stage

    with over_scans("compare", running, output.quiet) as run:
        found, failures = stage(before, after, query=query, options=run)
    failed = [failure.to_dict() for failure in failures]
    output.result(
        {"stage": "compare", **found.to_dict(), "failures": failed}, comparison_tables(found)
    )
    summary.name_failures(failures)
    output.say(f"compare: {counted(len(found.pairs), 'scan')} → {after / RECORD}")
    summary.leave(failures)


def evaluate(
    *,
    results: arguments.Results,
    by_distance: arguments.ByDistance = False,
    query: ResultQuery,
    running: arguments.Reading,
    output: console.Output,
) -> None:
    """Compare predictions with labels, as the official benchmark does.

    Scans that the weights were trained on are left out, unless all were.

    Example: salsanext eval --split valid
    """
    from salsanext_cli.results.result_folder import ResultFolder
    from salsanext_cli.stages.evaluate import evaluate as stage
    from salsanext_cli.stages.evaluate import part_of

    out = results.folder()
    folder = ResultFolder(out, query.dataset)
    files, space = folder.predicted(query.selection, query.label_space, query.classes)
    part = part_of(folder, files, query.selection)
    with over_scans("eval", running, output.quiet) as run:
        settings, rejection = folder.provenance(query.selection), folder.rejection()
        found = stage(
            files,
            out,
            space,
            run,
            part,
            by_distance=by_distance,
            settings=settings,
            labels=query.label_space,
        )
    output.result(found.to_dict(), _evaluation_shown(found, rejection.above if rejection else None))
    summary.name_failures(found.failures)
    scans = f"{counted(found.counts.scans, 'scan')}{summary.left_out(found.missing)}"
    output.say(f"eval: {scans} → {found.folder}/scores.txt, eval.json, eval_*.png")
    summary.leave(found.failures, found.missing)


def _evaluation_shown(found: "Evaluation", reject: float | None) -> "Group":
    """Return the tables and sentences of an evaluation, what was asked for last."""
    from rich.console import Group
    from rich.text import Text

    from salsanext_cli.report.tables import (
        accepted_table,
        band_table,
        score_table,
        uncertainty_tables,
    )
    from salsanext_cli.stages.evaluate import ON_TRAINING_SCANS

    of_training = ON_TRAINING_SCANS if found.counts.trained_on else ""
    shown: list[Any] = [score_table(found.scores, of_training)]
    shown += [band_table(found.by_distance)] if found.by_distance else []
    shown += uncertainty_tables(found.uncertainty)
    shown += [Text(found.uncertainty.accepted.sentence)] if found.uncertainty.accepted else []
    shown += [Text(found.object_sentence)] if found.panoptic else []
    if kept := found.accepted:
        missed = f"Points left unlabelled by predict --reject {reject:g} are missed in the scores."
        promised = [found.guarantee.sentence] if found.guarantee else []
        lines = [missed, *kept.sentences, *promised]
        shown += [accepted_table(kept.classes), Text("\n".join(lines))]
    return Group(*shown)


@option_group
class CloudOptions:
    """Colours of the clouds of `export-ply`."""

    colour: str = own_option(f"{COLOUR_HELP}.", "--colour", "--color", default="label")
    scale: tuple[float, float] | None = own_option(
        "Values at the two ends of the colour map.",
        show_default="range of most values; fixed for error",
    )
    max_error: float | None = own_option(
        "Write points as unlabelled whose error is above this, 0 to 1."
    )


def export_ply(
    *,
    results: arguments.Results,
    clouds: CloudOptions,
    as_map: Annotated[
        bool, typer.Option("--map", help="Write one cloud of each drive with labels of `fuse`.")
    ] = False,
    voxel: Annotated[
        float | None,
        typer.Option(
            "--map-voxel",
            help="Edge of the voxels of one point each, in metres.",
            show_default="0.1",
        ),
    ] = None,
    query: ResultQuery,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write coloured point clouds that hold every known value of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.stages.export_ply import export_ply as stage

    if voxel is not None and not as_map:
        raise UsageError("--map-voxel", "without --map", "both, or neither")
    out = results.folder()
    with over_scans("export-ply", running, output.quiet) as run:
        map_voxel = (0.1 if voxel is None else voxel) if as_map else None
        outcome = stage(out, **asdict(clouds), voxel=map_voxel, query=query, options=run)
    summary.finish("export-ply", outcome, out, output)
