# SPDX-License-Identifier: MIT
"""`salsanext uncertainty`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from salsanext_cli.cli import console, options, run_end, run_options, selection_options


def uncertainty(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    method: Annotated[
        Literal["sampling", "analytic"],
        typer.Option(help="Monte-Carlo dropout, or an estimate of it in one pass."),
    ] = "sampling",
    samples: Annotated[int, typer.Option(help="Monte-Carlo passes per scan.")] = 30,
    seed: Annotated[int, typer.Option(help="Seed of the dropout masks and the noise.")] = 0,
    aleatoric: Annotated[
        Literal["copies", "paper", "none"],
        typer.Option(
            help="The sensor's noise, for aleatoric and total uncertainty: by eight noisy copies "
            "of each scan, or carried through the network as in the paper."
        ),
    ] = "copies",
    selection: selection_options.SourceSelection,
    merged: options.MergedClasses,
    network: options.AdaptableNetwork,
    knn: options.Knn,
    running: run_options.Checked,
    output: console.Output,
) -> None:
    """Predict the class of every point and its epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.stages.uncertainty import uncertainty as stage
    from salsanext_cli.uncertainty.method import UncertaintyMethod

    with running.over_scans("uncertainty", output) as run:
        outcome = stage(
            selection.source(scans),
            out,
            network=replace(network.settings(), classes=merged.space()),
            knn=knn.parameters(),
            method=UncertaintyMethod(method, samples, seed, aleatoric),
            selection=selection.scans(),
            options=run,
        )
    run_end.finish("uncertainty", outcome, out, output, strict=running.strict)
