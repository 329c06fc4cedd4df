# SPDX-License-Identifier: MIT
"""`salsanext fuse`."""

from pathlib import Path
from typing import Annotated

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import command_on_labels
from salsanext_cli.commands.line.output.printed_plan import print_plan
from salsanext_cli.commands.line.output.progress import over_results
from salsanext_cli.core.fusion.reach import FusionReach
from salsanext_cli.core.notices import demote_reader_notices
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.results.query import ResultQuery


def fuse(
    out: Path = declarations.RESULTS,
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
    dry_run: bool = declarations.DRY_RUN,
    output: console.Output,
) -> None:
    """Improve the labels of a drive: scans that overlap vote on each point.

    Example: salsanext fuse out/
    """
    from salsanext_cli.commands.stages.fuse import fuse_results, plan_fusion
    from salsanext_cli.runs.results.folder_names import FUSED

    target = target or out / FUSED
    if dry_run:
        with demote_reader_notices():
            plan = plan_fusion(out, target, poses=poses, reach=reach, query=query, options=running)
        print_plan("fuse", plan, target, output)
        return
    with over_results("fuse", running, output.quiet) as options:
        outcome = fuse_results(out, target, poses=poses, reach=reach, query=query, options=options)
    following = command_on_labels(outcome, target, query.selection.split)
    summary.print_summary_and_exit("fuse", outcome, target, output, following=following)
