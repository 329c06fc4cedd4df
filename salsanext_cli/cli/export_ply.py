# SPDX-License-Identifier: MIT
"""`salsanext export-ply`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options


@console.guarded
def export_ply(
    colour: Annotated[
        str,
        typer.Option(
            "--colour",
            "--color",
            help="label, truth, error, intensity, range, uncertainty, or one kind of it: "
            "epistemic, aleatoric, total, entropy, mutual_information.",
        ),
    ] = "label",
    scale: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Values at the ends of the colour map.", show_default="what most points span"
        ),
    ] = None,
    out: options.OutOption = Path("out"),
    dataset: options.DataSetOfResults = None,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.Limit = None,
    label_space: options.LabelSpaceOption = None,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    sensor: options.Sensor = None,
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
    """Write coloured point clouds that carry every known value of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.stages.export_ply import export_ply as run

    output = console.Output(json, verbose, quiet)
    runs = run_options.gather(
        jobs, backend, scheduler, on_error, overwrite, run_options.share(shard, output)
    )
    with console.batch("export-ply", output, runs) as batch:
        outcome = run(
            out,
            colour=colour,
            scale=scale,
            dataset=dataset,
            usual_dataset=options.usual_dataset(),
            space=options.label_space(label_space),
            network=options.network(weights, device, sensor, precision),
            selection=options.choice(split, sequences, limit),
            options=batch,
        )
    console.finish("export-ply", outcome, out, output, outcome.missing)
