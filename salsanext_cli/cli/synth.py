# SPDX-License-Identifier: MIT
"""`salsanext synth`."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.cli.progress import progress
from salsanext_cli.errors import counted


def synth(
    out: Annotated[Path, typer.Argument(metavar="DATASET", help="Root of the new data set.")],
    *,
    train: Annotated[int, typer.Option(help="Number of sequences for training.")] = 8,
    valid: Annotated[int, typer.Option(help="Number of sequences for validation.")] = 2,
    test: Annotated[int, typer.Option(help="Number of sequences for testing.")] = 0,
    scans: Annotated[int, typer.Option(help="Scans per sequence.")] = 20,
    spacing: Annotated[
        float, typer.Option(help="Distance driven between two scans, in metres.")
    ] = 3.0,
    sensor: Annotated[
        Literal["hdl64", "random"],
        typer.Option(help="An HDL-64E, or a random sensor for each sequence."),
    ] = "hdl64",
    seed: Annotated[int, typer.Option(help="The same seed gives the same bytes.")] = 0,
    jobs: options.Jobs = 1,
    overwrite: options.Overwrite = False,
    output: console.Output,
) -> None:
    """Generate labelled scans of synthetic streets, in SemanticKITTI's layout.

    Example: salsanext synth streets/ --train 8 --valid 2 --scans 20
    """
    from salsanext_cli.stages.synth import synthesise

    with progress("synth", output.quiet) as on_progress:
        made = synthesise(
            out,
            train=train,
            valid=valid,
            test=test,
            scans=scans,
            seed=seed,
            spacing=spacing,
            sensor=sensor,
            jobs=jobs,
            overwrite=overwrite,
            progress=on_progress,
        )
    output.result(made)
    output.say(
        f"synth: {counted(made['scans'], 'scan')}, {sum(made['points'].values()):,} points → {out}"
    )
