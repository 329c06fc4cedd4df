# SPDX-License-Identifier: MIT
"""`salsanext knn-refine`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


@console.guarded
def knn_refine(
    out: options.Out = Path("out"),
    labels: Annotated[
        Path | None,
        typer.Option(help="Refine the .label files of this folder, of any origin, instead."),
    ] = None,
    dataset: options.DataSetOfResults = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    label_space: options.LabelSpaceOption = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            help="Name of a sensor or a .toml file.",
            show_default="the one of the earlier stages, else hdl64",
            rich_help_panel="Network",
        ),
    ] = None,
    knn_k: options.K = 5,
    knn_window: options.Window = 5,
    knn_sigma: options.Sigma = 1.0,
    knn_cutoff: options.Cutoff = 1.0,
    jobs: run_options.Jobs = None,
    backend: run_options.BackendOption = run_options.Backend.loky,
    scheduler: run_options.Scheduler = None,
    shard: run_options.Share = None,
    overwrite: options.Overwrite = False,
    on_error: options.OnErrorOption = options.OnError.skip,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Turn pixel labels, or anybody's point labels, into clean point labels.

    Example: salsanext knn-refine out/
    """
    from salsanext_cli.stages.knn_refine import knn_refine_scans

    output = console.Output(json, verbose, quiet)
    runs = run_options.gather(
        jobs, backend, scheduler, on_error, overwrite, run_options.share(shard, output)
    )
    with console.batch("knn-refine", output, runs) as batch:
        outcome = knn_refine_scans(
            out,
            labels=labels,
            dataset=dataset,
            usual_dataset=options.usual_dataset(),
            sensor=options.sensor(sensor) if sensor else None,
            space=options.label_space(label_space),
            knn=options.knn(knn_k, knn_window, knn_sigma, knn_cutoff),
            selection=options.choice(split, sequences, limit),
            options=batch,
        )
    console.finish("knn-refine", outcome, out, output)
