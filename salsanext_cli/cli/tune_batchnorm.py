# SPDX-License-Identifier: MIT
"""`salsanext tune batchnorm`."""

from typing import Annotated

import typer

from salsanext_cli.cli import options, run_options
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import progress


def tune_batchnorm(
    scans: options.RequiredScans,
    target: options.WeightsOut,
    *,
    share: Annotated[
        float,
        typer.Option(
            help="Weight of the new statistics, above 0 and at most 1; the old ones have the rest."
        ),
    ] = 0.5,
    selection: Annotated[options.SpacedSelection, Without({"dataset"})],
    network: options.NetworkOptions,
    overwrite: run_options.Overwrite = False,
    output: run_options.Output,
) -> None:
    """Adapt batch normalisation to scans of another sensor or place, without labels.

    Example: salsanext tune batchnorm my/scans adapted.safetensors --sensor hdl32
    """
    from salsanext_cli.report.tuning import moved_table
    from salsanext_cli.stages.tune_batchnorm import tune_batchnorm as stage

    with progress("tune batchnorm", output.quiet) as on_progress:
        tuned = stage(
            scans,
            target,
            network=network.settings(),
            selection=selection.scans(),
            share=share,
            overwrite=overwrite,
            progress=on_progress,
        )
    found = tuned.to_dict()
    output.result(found | {"weights": str(target)}, moved_table(found["layers"]))
    output.say(f"tune batchnorm: {tuned.scans} scans of {tuned.sensor} → {target}")
