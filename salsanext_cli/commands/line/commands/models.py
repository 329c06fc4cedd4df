# SPDX-License-Identifier: MIT
"""Commands on weights files: describe, import and export them."""

from pathlib import Path

from salsanext_cli.commands.line.options import arguments
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console
from salsanext_cli.runs.network_settings import DEFAULT_WEIGHTS, weights_file
from salsanext_cli.runs.results.query import named_label_space


def models(
    weights: list[Path] | None = argument(
        "Weights files to describe.",
        metavar="WEIGHTS...",
        show_default="the weights of the package",
    ),
    *,
    output: console.Output,
) -> None:
    """Describe weights; list networks and plug-ins.

    Example: salsanext models runs/street/best.safetensors
    """
    from rich.console import Group, RenderableType
    from rich.text import Text

    from salsanext_cli.commands.stages.models import describe_weights, plug_ins
    from salsanext_cli.core.network.registry import ARCHITECTURES, plugged_networks
    from salsanext_cli.core.network.weights_names import PAPER_NETWORKS
    from salsanext_cli.core.optional_packages import extra_command
    from salsanext_cli.report.card_table import card_table
    from salsanext_cli.report.tables import table_of

    networks = [*ARCHITECTURES, *plugged_networks()]
    installed = plug_ins()
    described = [describe_weights(weights_file(path)) for path in weights or [DEFAULT_WEIGHTS]]
    tables: list[RenderableType] = [card_table(card) for card in described]
    if installed:
        headings = list(installed[0])
        rows = [list(plug_in.values()) for plug_in in installed]
        tables.append(table_of(headings, rows, texts=headings, title="Plug-ins"))
    tables.append(Text(f"networks: {', '.join(networks)}"))
    if not any(name.startswith(PAPER_NETWORKS) for name in networks):
        tables.append(Text(f"networks of the papers: {extra_command('paper')}"))
    result = {"stage": "models", "models": networks, "plug_ins": installed, "weights": described}
    output.result(result, Group(*tables))


def import_weights(
    source: Path = argument(
        "Published checkpoint, or weights file (.safetensors).", default=..., metavar="CHECKPOINT"
    ),
    target: Path = arguments.WEIGHTS_OUT,
    *,
    label_space: str | None = option(
        "Label space of the checkpoint: built-in, or a .yaml file in SemanticKITTI's format.",
        metavar="NAME|FILE",
        show_default="semantic-kitti",
    ),
    sensor: str | None = arguments.SENSOR,
    dropout: float | None = option(
        "Dropout rate of the training of the checkpoint.", show_default="0.2"
    ),
    description: str = option(
        "Description to store in the weights file.", default="", metavar="TEXT"
    ),
    half: bool = option("Store in float16, at half the size.", default=False),
    overwrite: bool = arguments.OVERWRITE,
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
        sensor=arguments.sensor(sensor),
        dropout=dropout,
        description=description,
        half=half,
        overwrite=overwrite,
    )
    output.result({"stage": "import-weights", **describe_weights(target).to_dict()})
    output.print(f"import-weights: {source} → {target}")


def export_onnx(
    weights: Path = argument(
        "Weights file (.safetensors), or `default` for the weights of the package.",
        default=...,
        metavar="WEIGHTS",
    ),
    target: Path = argument("ONNX model to write (.onnx).", default=..., metavar="MODEL"),
    *,
    sensor: str | None = arguments.sensor_option(show_default="the sensor of the weights"),
    dynamic_width: bool = option("Accept any width that is a multiple of 16 or 32.", default=False),
    overwrite: bool = arguments.OVERWRITE,
    output: console.Output,
) -> None:
    """Write weights as an ONNX model for OpenVINO, ONNX Runtime and TensorRT.

    Example: salsanext export-onnx weights.safetensors model.onnx
    """
    from salsanext_cli.commands.stages.export_onnx import export_onnx as stage

    report = stage(
        weights_file(weights),
        target,
        sensor=arguments.sensor(sensor),
        dynamic_width=dynamic_width,
        overwrite=overwrite,
    )
    output.result(report.to_dict())
    if report.difference is None:
        output.print("the model was not compared with torch, because onnxruntime is not installed")
    else:
        output.print(f"largest difference from torch: {report.difference:.1e} of the largest logit")
    output.print(f"export-onnx: {weights} → {target}")
