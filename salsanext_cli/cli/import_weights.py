# SPDX-License-Identifier: MIT
"""`salsanext import-weights`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options


@console.guarded
def import_weights(
    source: Annotated[
        Path, typer.Argument(help="A published checkpoint, or a .safetensors file of ours.")
    ],
    target: Annotated[Path, typer.Argument(help="The .safetensors file to write.")],
    label_space: Annotated[
        str | None,
        typer.Option(
            help="Classes of a checkpoint: a label space or a .yaml file in SemanticKITTI's form.",
            show_default="semantic-kitti",
        ),
    ] = None,
    sensor: options.SensorWithoutWeights = None,
    dropout: Annotated[
        float | None,
        typer.Option(help="Rate that a checkpoint was trained with.", show_default="0.2"),
    ] = None,
    description: Annotated[str, typer.Option(help="What these weights are.")] = "",
    half: Annotated[bool, typer.Option("--half", help="Store in float16, half the size.")] = False,
    overwrite: options.Overwrite = False,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """Make a weights file of a published checkpoint, without running anything inside it.

    Example: salsanext import-weights pretrained/SalsaNext salsanext.safetensors
    """
    from salsanext_cli.stages.import_weights import import_weights as run
    from salsanext_cli.stages.models import describe_weights

    output = console.Output(json, verbose, quiet)
    run(
        source,
        target,
        space=options.label_space(label_space),
        view=options.sensor(sensor) if sensor else None,
        dropout=dropout,
        description=description,
        half=half,
        overwrite=overwrite,
    )
    output.result(describe_weights(target))
    output.say(f"import-weights: {source} → {target}")
