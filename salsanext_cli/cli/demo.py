# SPDX-License-Identifier: MIT
"""`salsanext demo`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import progress


def demo(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder for the data and the results.")
    ] = Path("demo"),
    *,
    scans: Annotated[int, typer.Option(help="Number of scans of the synthetic drive.")] = 4,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 8,
    classes: options.MergedInto = None,
    network: Annotated[options.NetworkOptions, Without({"sensor", "columns", "min_range", "ego"})],
    jobs: options.Jobs = 1,
    overwrite: options.Overwrite = False,
    output: console.Output,
) -> None:
    """Run the whole pipeline on a synthetic drive and list what to look at.

    Example: salsanext demo demo/
    """
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.report.tables import score_table
    from salsanext_cli.stages.demo import demo as stage

    made = stage(
        folder,
        scans=scans,
        samples=samples,
        network=replace(network.settings(), classes=options.label_space(classes)),
        options=RunOptions(jobs=jobs, overwrite=overwrite),
        bars=lambda step: progress(step, output.quiet),
    )
    pictures, out = [str(path) for path in made.pictures], folder / "out"
    result = made.evaluation.to_dict() | {"stage": "demo", "pictures": pictures}
    result["page"] = str(made.page)
    output.result(result, score_table(made.evaluation.scores))
    failures = (*made.failures, *made.evaluation.failures)
    run_end.name_failures(failures)
    output.say("look at:")
    for path in (
        f"{out}/sequences/00/pictures/*.png",
        f"{out}/eval_iou.png",
        f"{out}/eval_confusion.png",
    ):
        output.say(f"  {path}")
    output.say(f"  {out}/sequences/00/ply/*.ply   in CloudCompare, MeshLab or open3d")
    output.say(f"scans: {folder / 'data'}; results of every stage: {out}/sequences/00")
    output.say(f"everything on one page, for any browser: {made.page}")
    run_end.leave(failures, made.evaluation.missing)
