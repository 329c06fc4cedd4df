# SPDX-License-Identifier: MIT
"""Commands of the panel Models, but `tune`: weights files, described and converted."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import arguments, console
from salsanext_cli.engines.settings import DEFAULT_WEIGHTS, weights_file
from salsanext_cli.results.query import named_label_space


def models(
    weights: Annotated[
        list[Path] | None, typer.Argument(help="Weights files to describe.", show_default="default")
    ] = None,
    *,
    output: console.Output,
) -> None:
    """List the networks with their cost and the papers' figures, and plug-ins; describe weights.

    Example: salsanext models runs/street/best.safetensors
    """
    from rich.console import Group

    from salsanext_cli.report.tables import card_table, network_table, table_of
    from salsanext_cli.stages.models import describe_weights, plug_ins
    from salsanext_cli.stages.models import models as stage

    listed, plugged = stage(), plug_ins()
    described = [describe_weights(weights_file(path)) for path in weights or [DEFAULT_WEIGHTS]]
    cards = map(card_table, described)
    networks = [network_table(listed)]
    if plugged:
        rows = [[*each.values()] for each in plugged]
        networks.append(table_of([*plugged[0]], rows, texts=[*plugged[0]], title="Plug-ins"))
    tables = Group(*cards, *networks) if weights else Group(*networks, *cards)
    result = {"stage": "models", "models": listed, "plug_ins": plugged, "weights": described}
    output.result(result, tables)


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
    sensor: arguments.SensorWithoutWeights = None,
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
    overwrite: arguments.Overwrite = False,
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
        space=named_label_space(label_space),
        view=arguments.sensor(sensor),
        dropout=dropout,
        description=description,
        half=half,
        overwrite=overwrite,
    )
    output.result({"stage": "import-weights", **describe_weights(target).to_dict()})
    output.say(f"import-weights: {source} → {target}")


WEIGHTS_HELP = "Weights file (.safetensors); default: those of the package."


def export_onnx(
    weights: Annotated[Path, typer.Argument(help=WEIGHTS_HELP)],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="ONNX model to write (.onnx).")],
    *,
    sensor: Annotated[
        str | None,
        typer.Option(help=arguments.SENSOR_HELP, show_default="the sensor of the weights"),
    ] = None,
    dynamic_width: Annotated[
        bool,
        typer.Option("--dynamic-width", help="Take images of any width that 16 or 32 divides."),
    ] = False,
    overwrite: arguments.Overwrite = False,
    output: console.Output,
) -> None:
    """Write weights as an ONNX model for OpenVINO, ONNX Runtime and TensorRT.

    Example: salsanext export-onnx weights.safetensors model.onnx
    """
    from salsanext_cli.stages.export_onnx import export_onnx as stage

    done = stage(
        weights_file(weights),
        target,
        view=arguments.sensor(sensor),
        dynamic_width=dynamic_width,
        overwrite=overwrite,
    )
    output.result(done)
    if done["difference"] is None:
        output.say("the model was not compared with torch, because onnxruntime is not installed")
    else:
        output.say(f"largest difference from torch: {done['difference']:.1e} of the largest logit")
    output.say(f"export-onnx: {weights} → {target}")
