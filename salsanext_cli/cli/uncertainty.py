# SPDX-License-Identifier: MIT
"""`salsanext uncertainty`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from salsanext_cli.cli import console, options, run_end
from salsanext_cli.cli.progress import over_scans
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.options import RunOptions


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
    dataset: options.DataSet = None,
    selection: ScanSelection,
    topic: options.Topic = None,
    classes: options.MergedInto = None,
    network: options.AdaptableNetwork,
    knn: options.Knn,
    running: RunOptions,
    strict: options.Strict = False,
    output: console.Output,
) -> None:
    """Predict the class of every point and its epistemic, aleatoric and total uncertainty.

    Example: salsanext uncertainty seq/velodyne out/ --samples 30
    """
    from salsanext_cli.stages.uncertainty import uncertainty as stage
    from salsanext_cli.uncertainty.method import UncertaintyMethod

    with over_scans("uncertainty", running, output.quiet) as run:
        outcome = stage(
            options.source(scans, dataset, topic),
            out,
            network=replace(network.settings(), classes=options.label_space(classes)),
            knn=knn.parameters(),
            method=UncertaintyMethod(method, samples, seed, aleatoric),
            selection=selection,
            options=run,
        )
    run_end.finish("uncertainty", outcome, out, output, strict=strict)
