# SPDX-License-Identifier: MIT
"""`salsanext predict`."""

import re
from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options, run_options
from salsanext_cli.errors import UsageError


def predict(
    scans: options.Scans = None,
    out: options.Out = Path("out"),
    *,
    pixel_labels: Annotated[
        bool, typer.Option("--pixel-labels", help="Also write the label of every pixel.")
    ] = False,
    probabilities: Annotated[
        bool,
        typer.Option("--probabilities", help="Also write the class probabilities of every point."),
    ] = False,
    selection: options.Selection,
    network: options.NetworkOptions,
    knn: options.Knn,
    batch: Annotated[
        str,
        typer.Option(
            help="Scans computed together, halved when memory runs out; auto: 1 on a CPU, on a "
            "GPU as many as keep it busy.",
            rich_help_panel="Running",
        ),
    ] = "auto",
    running: run_options.Running,
    output: run_options.Output,
) -> None:
    """Predict the class of every point of every scan.

    Example: salsanext predict seq/velodyne out/
    """
    from salsanext_cli.stages.predict import predict as stage

    extras = {"pixel_labels": pixel_labels, "probabilities": probabilities}
    with running.over_scans("predict", output) as run:
        outcome = stage(
            selection.source(scans),
            out,
            network=network.settings(),
            knn=knn.parameters(),
            extras=tuple(name for name, wanted in extras.items() if wanted),
            batch=_batch_size(batch),
            selection=selection.scans(),
            options=run,
        )
    console.finish("predict", outcome, out, output)


def _batch_size(text: str) -> int | None:
    """Return the number of scans computed together, None for what suits the device."""
    if text == "auto":
        return None
    if not re.fullmatch(r"\d{1,9}", text, re.ASCII):
        raise UsageError("--batch", repr(text), "auto, or a number of scans")
    return int(text)
