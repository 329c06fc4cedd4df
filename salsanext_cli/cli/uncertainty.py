# SPDX-License-Identifier: MIT
"""`salsanext uncertainty`."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


class Method(StrEnum):
    """How the spread of dropout is estimated."""

    sampling = "sampling"
    analytic = "analytic"


@console.guarded
def uncertainty(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    method: Annotated[
        Method, typer.Option(help="Monte-Carlo dropout, or an estimate of it in one pass.")
    ] = Method.sampling,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 30,
    seed: Annotated[int, typer.Option(help="Of the dropout masks.")] = 0,
    aleatoric: Annotated[
        bool,
        typer.Option(
            "--aleatoric/--no-aleatoric",
            help="Also aleatoric and total uncertainty, from the sensor's noise.",
        ),
    ] = True,
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
    """Say of every point how sure its class is: epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.stages.uncertainty import uncertainty as run
    from salsanext_cli.uncertainty.settings import Estimator

    output = console.Output(json, verbose, quiet)
    runs = run_options.gather(
        jobs, backend, scheduler, on_error, overwrite, run_options.share(shard, output)
    )
    with console.batch("uncertainty", output, runs) as batch:
        outcome = run(
            options.source(scans, dataset),
            out,
            network=options.network(weights, device, sensor, precision),
            knn=options.knn(knn_k, knn_window, knn_sigma, knn_cutoff),
            estimator=Estimator(method.value, samples, seed, aleatoric),
            selection=options.choice(split, sequences, limit),
            options=batch,
        )
    console.finish("uncertainty", outcome, out, output)
