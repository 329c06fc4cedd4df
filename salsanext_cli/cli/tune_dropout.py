# SPDX-License-Identifier: MIT
"""`salsanext tune dropout`."""

from typing import Annotated

import typer

from salsanext_cli.cli import options, run_options
from salsanext_cli.cli.option_groups import Default, Without
from salsanext_cli.cli.progress import progress


def tune_dropout(
    dataset: options.LabelledDataSet,
    target: options.WeightsOut,
    *,
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan and rate.")] = 30,
    lowest: Annotated[float, typer.Option(help="Lowest rate to try.")] = 0.02,
    highest: Annotated[float, typer.Option(help="Highest rate to try.")] = 0.5,
    steps: Annotated[
        int, typer.Option(help="Number of rates to try, evenly spaced on a log scale.")
    ] = 10,
    seed: Annotated[int, typer.Option(help="Seed of the dropout masks.")] = 0,
    selection: Annotated[options.LabelledSelection, Without({"dataset"}), Default(limit=20)],
    network: options.NetworkOptions,
    overwrite: run_options.Overwrite = False,
    output: run_options.Output,
) -> None:
    """Find the dropout rate to sample with, write new weights and plot the search.

    Example: salsanext tune dropout streets/ tuned.safetensors --steps 10
    """
    from salsanext_cli.report.tuning import rate_table
    from salsanext_cli.stages.tune_dropout import curve_of
    from salsanext_cli.stages.tune_dropout import tune_dropout as stage

    with progress("tune dropout", output.quiet, unit="samplings") as on_progress:
        tuned = stage(
            dataset,
            target,
            network=network.settings(),
            selection=selection.scans(),
            samples=samples,
            seed=seed,
            lowest=lowest,
            highest=highest,
            steps=steps,
            overwrite=overwrite,
            progress=on_progress,
        )
    paths = {"weights": str(target), "curve": str(curve_of(target))}
    output.result(tuned.to_dict() | paths, rate_table(tuned.rates, tuned.objectives, tuned.best))
    output.say(
        f"tune dropout: {tuned.best:.4g}, was {tuned.before:g} → {target}, {curve_of(target)}"
    )
