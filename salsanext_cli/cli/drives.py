# SPDX-License-Identifier: MIT
"""Commands that work on results: of drives, of points to leave out, of two runs."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.console import over_scans
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.errors import UsageError, counted
from salsanext_cli.options import FusionReach, ScanSelection
from salsanext_cli.parallel.options import RunOptions


def fuse(
    out: options.Out = Path("out"),
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
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    running: RunOptions,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Correct the labels of each scan of a drive by all scans that see the same places.

    Example: salsanext fuse out/
    """
    from salsanext_cli.stages.fuse import FUSED, fuse_results

    target = target or out / FUSED
    with over_scans("fuse", running, output.quiet) as run:
        outcome = fuse_results(
            out,
            target,
            poses=poses,
            reach=reach,
            dataset=dataset,
            selection=selection,
            options=run,
        )
    run_end.finish("fuse", outcome, target, output, split=selection.split, strict=strict)


def class_names(text: str | None) -> list[str]:
    """Return the names in a list such as person,vehicle."""
    names = [name.strip() for name in (text or "").split(",") if name.strip()]
    if text is not None and not names:
        raise UsageError("--drop and --keep", repr(text), "names of classes, such as car,person")
    return names


def filter_command(
    out: options.Out = Path("out"),
    *,
    to: Annotated[Path, typer.Option(metavar="FOLDER", help="New folder to write.")],
    drop: Annotated[
        str | None,
        typer.Option(
            help="Leave out these classes, such as person,vehicle; coarse names too, and "
            "moving for all that may move."
        ),
    ] = None,
    keep: Annotated[
        str | None, typer.Option(help="Keep these classes only.", show_default="all")
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(help="Leave out points whose error is above this, 0 to 1."),
    ] = None,
    split: Annotated[bool, typer.Option("--split", help="Write a file for each class.")] = False,
    indices: Annotated[
        bool, typer.Option("--indices", help="Write masks of the points that stay (.npy).")
    ] = False,
    dataset: options.DataSetOfResults = None,
    selection: Annotated[ScanSelection, Without({"split"})],
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write the scans in their own format without some of their points, by class or error.

    Example: salsanext filter out/ --drop moving --to static/
    """
    from salsanext_cli.stages.filter import filter_scans

    with over_scans("filter", running, output.quiet) as run:
        outcome = filter_scans(
            *(out, to),
            drop=class_names(drop),
            keep=class_names(keep),
            max_error=max_error,
            split=split,
            indices=indices,
            dataset=dataset,
            selection=selection,
            options=run,
        )
    run_end.finish("filter", outcome, to, output)


def compare(
    before: Annotated[Path, typer.Argument(metavar="OUT_A", help="Results of the first run.")],
    after: Annotated[Path, typer.Argument(metavar="OUT_B", help="Results of the second run.")],
    *,
    by_distance: options.ByDistance = False,
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    running: options.Reading,
    output: console.Output,
) -> None:
    """Compare two runs on the same scans: what changed, and whether it is better.

    Scans that the weights of a run were trained on are left out of the scores.

    Example: salsanext compare out/ tuned/
    """
    from salsanext_cli.report.comparison import comparison_tables
    from salsanext_cli.stages.compare import FILES
    from salsanext_cli.stages.compare import compare as stage

    with over_scans("compare", running, output.quiet) as run:
        found, failures = stage(
            *(before, after),
            by_distance=by_distance,
            dataset=dataset,
            space=options.label_space(label_space),
            classes=options.label_space(classes),
            selection=selection,
            options=run,
        )
    failed = [failure.to_dict() for failure in failures]
    output.result(
        {"stage": "compare", **found.to_dict(), "failures": failed}, comparison_tables(found)
    )
    run_end.name_failures(failures)
    output.say(f"compare: {counted(len(found.pairs), 'scan')} → {after}/{', '.join(FILES)}")
    run_end.leave(failures)
