# SPDX-License-Identifier: MIT
"""`salsanext import-weights`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console
from salsanext_cli.commands.line.values.typed_values import typed_sensor
from salsanext_cli.runs.results.query import named_label_space


def import_weights(
    source: Path = argument(
        "Published checkpoint, or weights file (.safetensors).", default=..., metavar="CHECKPOINT"
    ),
    target: Path = declarations.WEIGHTS_OUT,
    *,
    label_space: str | None = option(
        "Label space of the checkpoint: built-in, or a .yaml file in SemanticKITTI's format.",
        metavar="NAME|FILE",
        show_default="semantic-kitti",
    ),
    sensor: str | None = declarations.SENSOR,
    dropout: float | None = option(
        "Dropout rate of the training of the checkpoint.", show_default="0.2"
    ),
    description: str = option(
        "Description to store in the weights file.", default="", metavar="TEXT"
    ),
    half: bool = option("Store in float16, at half the size.", default=False),
    overwrite: bool = declarations.OVERWRITE,
    output: console.Output,
) -> None:
    """Convert a published checkpoint to a weights file, without running code in it.

    Example: salsanext import-weights pretrained/SalsaNext salsanext.safetensors
    """
    from salsanext_cli.commands.stages.import_weights import import_weights as stage
    from salsanext_cli.commands.stages.models import describe_weights

    stage(
        source,
        target,
        space=named_label_space(label_space),
        sensor=typed_sensor(sensor),
        dropout=dropout,
        description=description,
        half=half,
        overwrite=overwrite,
    )
    output.result({"stage": "import-weights", **describe_weights(target).to_dict()})
    output.print(f"import-weights: {source} → {target}")
