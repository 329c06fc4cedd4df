# SPDX-License-Identifier: MIT
"""`salsanext export-ply`."""

from dataclasses import replace
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.option_groups import Without
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


def export_ply(
    *,
    results: options.Results,
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
    dataset: options.DataSetOfResults = None,
    selection: ScanSelection,
    label_space: options.LabelSpaceName = None,
    classes: options.MergedInto = None,
    network: Annotated[options.NetworkOptions, Without({"columns"})],
    running: RunOptions,
    output: console.Output,
) -> None:
    """Write coloured point clouds that hold every known value of every point.

    Example: salsanext export-ply --colour uncertainty
    """
    from salsanext_cli.stages.export_ply import export_ply as stage

    out = results.folder()
    with over_scans("export-ply", running, output.quiet) as run:
        outcome = stage(
            out,
            colour=colour,
            scale=scale,
            max_error=max_error,
            form=form,
            dataset=dataset,
            space=options.label_space(label_space),
            network=replace(network.settings(), classes=options.label_space(classes)),
            selection=selection,
            options=run,
        )
    run_end.finish("export-ply", outcome, out, output)
