# SPDX-License-Identifier: MIT
"""`salsanext export-onnx`."""

from pathlib import Path

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.output import console
from salsanext_cli.commands.line.values.typed_values import typed_sensor
from salsanext_cli.runs.network_settings import weights_file


def export_onnx(
    weights: Path = argument(
        "Weights file (.safetensors), or `default` for the weights of the package.",
        default=...,
        metavar="WEIGHTS",
    ),
    target: Path = argument("ONNX model to write (.onnx).", default=..., metavar="MODEL"),
    *,
    sensor: str | None = declarations.sensor_option(show_default="the sensor of the weights"),
    dynamic_width: bool = option("Accept any width that is a multiple of 16 or 32.", default=False),
    overwrite: bool = declarations.OVERWRITE,
    output: console.Output,
) -> None:
    """Write weights as an ONNX model for OpenVINO, ONNX Runtime and TensorRT.

    Example: salsanext export-onnx weights.safetensors model.onnx
    """
    from salsanext_cli.commands.stages.export_onnx import export_onnx as stage

    report = stage(
        weights_file(weights),
        target,
        sensor=typed_sensor(sensor),
        dynamic_width=dynamic_width,
        overwrite=overwrite,
    )
    output.result(report.to_dict())
    if report.difference is None:
        output.print("the model was not compared with torch, because onnxruntime is not installed")
    else:
        output.print(f"largest difference from torch: {report.difference:.1e} of the largest logit")
    output.print(f"export-onnx: {weights} → {target}")
