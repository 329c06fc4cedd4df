# SPDX-License-Identifier: MIT
"""`salsanext tune temperature`."""

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress


@console.guarded
def tune_temperature(
    dataset: options.LabelledDataSet,
    target: options.WeightsOut,
    split: options.SplitOfLabels = None,
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
    """Fit the temperature that makes probabilities honest, into a new weights file.

    Example: salsanext tune temperature streets/ tuned.safetensors --limit 50
    """
    from dataclasses import asdict

    from salsanext_cli.report.tuning import temperature_table
    from salsanext_cli.stages.tune_temperature import tune_temperature as run

    output = console.Output(json, verbose, quiet)
    with progress("tune temperature", quiet) as advance:
        tuned = run(
            dataset,
            target,
            network=options.network(weights, device, sensor, precision),
            selection=options.labelled_selection(split, sequences, limit),
            overwrite=overwrite,
            progress=advance,
        )
    table = temperature_table(asdict(tuned.before), asdict(tuned.after))
    output.result(tuned.to_dict() | {"weights": str(target)}, table)
    output.say(f"tune temperature: {tuned.points:,} points of {tuned.scans} scans → {target}")
