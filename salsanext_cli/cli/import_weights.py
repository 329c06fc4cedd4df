# SPDX-License-Identifier: MIT
"""`salsanext import-weights`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options


def import_weights(
    source: Annotated[
        Path,
        typer.Argument(help="Published checkpoint, or weights file of salsanext (.safetensors)."),
    ],
    target: Annotated[Path, typer.Argument(help="Weights file to write (.safetensors).")],
    *,
    label_space: Annotated[
        str | None,
        typer.Option(
            help="Classes of a checkpoint: a label space, or a .yaml file in SemanticKITTI's "
            "format.",
            show_default="semantic-kitti",
        ),
    ] = None,
    sensor: options.SensorWithoutWeights = None,
    dropout: Annotated[
        float | None,
        typer.Option(help="Dropout rate that a checkpoint was trained with.", show_default="0.2"),
    ] = None,
    description: Annotated[
        str, typer.Option(help="Description to store in the weights file.")
    ] = "",
    half: Annotated[
        bool, typer.Option("--half", help="Store in float16, at half the size.")
    ] = False,
    overwrite: options.Overwrite = False,
    output: console.Output,
) -> None:
    """Convert a published checkpoint to a weights file, without running anything inside it.

    Example: salsanext import-weights pretrained/SalsaNext salsanext.safetensors
    """
    from salsanext_cli.stages.import_weights import import_weights as stage
    from salsanext_cli.stages.models import describe_weights

    stage(
        source,
        target,
        space=options.label_space(label_space),
        view=options.sensor(sensor),
        dropout=dropout,
        description=description,
        half=half,
        overwrite=overwrite,
    )
    output.result({"stage": "import-weights", **describe_weights(target)})
    output.say(f"import-weights: {source} → {target}")
