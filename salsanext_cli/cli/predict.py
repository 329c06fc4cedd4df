# SPDX-License-Identifier: MIT
"""`salsanext predict`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


@console.guarded
def predict(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    pixel_labels: Annotated[
        bool, typer.Option("--pixel-labels", help="Keep the labels of the range image.")
    ] = False,
    probabilities: Annotated[
        bool, typer.Option("--probabilities", help="Keep the softmax of every point.")
    ] = False,
    dataset: options.DataSet = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    sensor: options.Sensor = None,
    knn_k: options.K = 5,
    knn_window: options.Window = 5,
    knn_sigma: options.Sigma = 1.0,
    knn_cutoff: options.Cutoff = 1.0,
    batch: run_options.Batch = "auto",
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
    """Give every point of every scan a class.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.stages.predict import predict_scans as run

    output = console.Output(json, verbose, quiet)
    wanted = {"pixel_labels": pixel_labels, "probabilities": probabilities}
    runs = run_options.gather(
        jobs, backend, scheduler, on_error, overwrite, run_options.share(shard, output)
    )
    with console.batch("predict", output, runs) as how:
        outcome = run(
            options.source(scans, dataset),
            out,
            network=options.network(weights, device, sensor, precision),
            knn=options.knn(knn_k, knn_window, knn_sigma, knn_cutoff),
            extras=tuple(name for name, keep in wanted.items() if keep),
            batch=run_options.batch_size(batch),
            selection=options.choice(split, sequences, limit),
            options=how,
        )
    console.finish("predict", outcome, out, output)
