# SPDX-License-Identifier: MIT
"""`salsanext tune dropout`."""

from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress


@console.guarded
def tune_dropout(
    dataset: options.LabelledDataSet,
    target: options.WeightsOut,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan and rate.")] = 30,
    lowest: Annotated[float, typer.Option(help="Lowest rate to try.")] = 0.02,
    highest: Annotated[float, typer.Option(help="Highest rate to try.")] = 0.5,
    steps: Annotated[int, typer.Option(help="Rates to try, evenly on a log scale.")] = 10,
    seed: Annotated[int, typer.Option(help="Of the dropout masks.")] = 0,
    split: options.SplitOfLabels = None,
    sequences: options.Sequences = None,
    limit: Annotated[
        int,
        typer.Option(help="Only so many scans, evenly spaced.", rich_help_panel=options.SELECTION),
    ] = 20,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    sensor: options.Sensor = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Find the dropout rate to sample with, into a new weights file, and draw the curve.

    Example: salsanext tune dropout streets/ tuned.safetensors --steps 10
    """
    from salsanext_cli.report.tuning import rate_table
    from salsanext_cli.stages.tune_dropout import curve_of
    from salsanext_cli.stages.tune_dropout import tune_dropout as run

    output = console.Output(json, verbose, quiet)
    with progress("tune dropout", quiet, unit="samplings") as advance:
        tuned = run(
            dataset,
            target,
            network=options.network(weights, device, sensor, precision),
            selection=options.labelled_selection(split, sequences, limit),
            samples=samples,
            seed=seed,
            lowest=lowest,
            highest=highest,
            steps=steps,
            overwrite=overwrite,
            progress=advance,
        )
    paths = {"weights": str(target), "curve": str(curve_of(target))}
    output.result(tuned.to_dict() | paths, rate_table(tuned.rates, tuned.objectives, tuned.best))
    output.say(
        f"tune dropout: {tuned.best:.4g}, was {tuned.before:g} → {target}, {curve_of(target)}"
    )
