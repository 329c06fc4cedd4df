# SPDX-License-Identifier: MIT
"""`salsanext tune temperature`."""

from typing import Annotated

from salsanext_cli.cli import options, run_options
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import progress


def tune_temperature(
    dataset: options.LabelledDataSet,
    target: options.WeightsOut,
    *,
    selection: Annotated[options.LabelledSelection, Without({"dataset"})],
    network: options.NetworkOptions,
    overwrite: run_options.Overwrite = False,
    output: run_options.Output,
) -> None:
    """Fit the temperature that calibrates the probabilities, and write new weights.

    Example: salsanext tune temperature streets/ tuned.safetensors --limit 50
    """
    from dataclasses import asdict

    from salsanext_cli.report.tuning import temperature_table
    from salsanext_cli.stages.tune_temperature import tune_temperature as stage

    with progress("tune temperature", output.quiet) as on_progress:
        tuned = stage(
            dataset,
            target,
            network=network.settings(),
            selection=selection.scans(),
            overwrite=overwrite,
            progress=on_progress,
        )
    table = temperature_table(asdict(tuned.before), asdict(tuned.after))
    output.result(tuned.to_dict() | {"weights": str(target)}, table)
    output.say(f"tune temperature: {tuned.points:,} points of {tuned.scans} scans → {target}")
