# SPDX-License-Identifier: MIT
"""`salsanext tune batchnorm`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress


@console.guarded
def tune_batchnorm(
    scans: Annotated[
        Path,
        typer.Argument(
            metavar="SCANS", help="A scan, a folder of scans, a sequence or a data set."
        ),
    ],
    target: options.WeightsOut,
    share: Annotated[
        float,
        typer.Option(
            help="Of the new statistics, above 0 and at most 1; the rest are the old ones."
        ),
    ] = 0.5,
    split: options.Split = None,
    sequences: options.Sequences = None,
    limit: options.LimitSpaced = None,
    weights: options.Weights = None,
    device: options.Device = "auto",
    precision: options.Precision = "auto",
    sensor: options.Sensor = None,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Adapt batch norm to scans without labels, of another sensor or place, into new weights.

    Example: salsanext tune batchnorm my/scans adapted.safetensors --sensor hdl32
    """
    from salsanext_cli.report.tuning import moved_table
    from salsanext_cli.stages.tune_batchnorm import tune_batchnorm as run

    output = console.Output(json, verbose, quiet)
    with progress("tune batchnorm", quiet) as advance:
        tuned = run(
            scans,
            target,
            network=options.network(weights, device, sensor, precision),
            selection=options.choice(split, sequences, limit),
            share=share,
            overwrite=overwrite,
            progress=advance,
        )
    found = tuned.to_dict()
    output.result(found | {"weights": str(target)}, moved_table(found["layers"]))
    output.say(f"tune batchnorm: {tuned.scans} scans of {tuned.sensor} → {target}")
