# SPDX-License-Identifier: MIT
"""`salsanext demo`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress


@console.guarded
def demo(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="For data and results.")] = Path(
        "demo"
    ),
    scans: Annotated[int, typer.Option(help="Length of the synthetic drive.")] = 4,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 8,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    jobs: options.Jobs = 1,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Run the whole pipeline on a synthetic drive and say where to look.

    Example: salsanext demo demo/
    """
    from salsanext_cli.parallel.run import RunOptions
    from salsanext_cli.report.tables import score_table
    from salsanext_cli.stages.demo import demo as run

    output = console.Output(json, verbose, quiet)
    made = run(
        folder,
        scans=scans,
        samples=samples,
        network=options.network(weights, device, None, precision),
        options=RunOptions(jobs=jobs, overwrite=overwrite),
        bars=lambda step: progress(step, quiet),
    )
    pictures = [str(path) for path in made.pictures]
    result = made.evaluation.to_dict() | {"stage": "demo", "pictures": pictures}
    output.result(result, score_table(made.evaluation.scores))
    failures = (*made.failures, *made.evaluation.failures)
    console.name_failures(failures)
    output.say("look at:")
    for path in (*pictures, f"{made.out}/eval_iou.png", f"{made.out}/eval_confusion.png"):
        output.say(f"  {path}")
    output.say(f"  {made.out}/sequences/00/ply/*.ply   in CloudCompare, MeshLab or open3d")
    output.say(f"the scans are in {made.data}, results of each stage in {made.out}/sequences/00")
    incomplete = failures or made.evaluation.absent.missing
    raise typer.Exit(console.FAILED if incomplete else console.DONE)
