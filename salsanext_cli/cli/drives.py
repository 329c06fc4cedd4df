# SPDX-License-Identifier: MIT
"""Commands of the panel Pipeline that work on drives, not on single scans."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.console import over_scans
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
