# SPDX-License-Identifier: MIT
"""`salsanext export-ply`."""

from dataclasses import replace
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end, run_options, selection_options
from salsanext_cli.cli.option_groups import Without


def export_ply(
    *,
    results: selection_options.Results,
    colour: Annotated[
        str,
        typer.Option(
            "--colour",
            "--color",
            help="label, truth, wrong, intensity, range, uncertainty, or one kind of it: "
            "error, epistemic, aleatoric, total, entropy, mutual_information.",
        ),
    ] = "label",
    scale: Annotated[
        tuple[float, float] | None,
        typer.Option(
            help="Values at the two ends of the colour map.",
            show_default="range of most of the values",
        ),
    ] = None,
    max_error: Annotated[
        float | None,
        typer.Option(help="Write points as unlabelled whose error is above this, 0 to 1."),
    ] = None,
    form: Annotated[
        str, typer.Option("--format", help="ply, or las or laz with the classes of the ASPRS.")
    ] = "ply",
    selection: selection_options.ResultSelection,
    classes: selection_options.Classes,
    merged: options.MergedClasses,
    network: Annotated[options.NetworkOptions, Without({"columns"})],
    running: run_options.Running,
    output: console.Output,
) -> None:
    """Write coloured point clouds that hold every known value of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.stages.export_ply import export_ply as stage

    out = results.folder()
    with running.over_scans("export-ply", output) as run:
        outcome = stage(
            out,
            colour=colour,
            scale=scale,
            max_error=max_error,
            form=form,
            dataset=selection.dataset,
            space=classes.space(),
            network=replace(network.settings(), classes=merged.space()),
            selection=selection.scans(),
            options=run,
        )
    run_end.finish("export-ply", outcome, out, output)
