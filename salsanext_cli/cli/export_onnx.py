# SPDX-License-Identifier: MIT
"""`salsanext export-onnx`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options
from salsanext_cli.errors import UsageError, counted

WEIGHTS_HELP = "Weights file (.safetensors); default: those of the package."


def export_onnx(
    weights: Annotated[Path, typer.Argument(help=WEIGHTS_HELP)],
    target: Annotated[Path, typer.Argument(metavar="OUT", help="ONNX model to write (.onnx).")],
    *,
    sensor: Annotated[
        str | None,
        typer.Option(help=options.SENSOR_HELP, show_default="the sensor of the weights"),
    ] = None,
    dynamic_width: Annotated[
        bool,
        typer.Option("--dynamic-width", help="Take images of any width that 16 or 32 divides."),
    ] = False,
    int8: Annotated[
        bool, typer.Option("--int8", help="Quantise to bytes, with ranges from --calibrate.")
    ] = False,
    calibrate: Annotated[
        Path | None,
        typer.Option(metavar="SCANS", help="Scans for --int8, without labels: some tens."),
    ] = None,
    limit: Annotated[
        int, typer.Option(help="At most this number of scans to calibrate, evenly spaced.")
    ] = 40,
    overwrite: options.Overwrite = False,
    output: console.Output,
) -> None:
    """Write weights as an ONNX model for OpenVINO, ONNX Runtime and TensorRT.

    Example: salsanext export-onnx weights.safetensors model.onnx
    """
    from salsanext_cli.options import ScanSelection
    from salsanext_cli.stages.export_onnx import export_onnx as stage

    if int8 != (calibrate is not None):
        given, lacking = ("--int8", "--calibrate") if int8 else ("--calibrate", "--int8")
        raise UsageError(given, f"without {lacking}", "both or neither")
    done = stage(
        options.weights_file(weights),
        target,
        view=options.sensor(sensor),
        dynamic_width=dynamic_width,
        calibrate=calibrate,
        selection=ScanSelection(limit=limit),
        overwrite=overwrite,
    )
    output.result(done)
    output.say(f"largest difference from torch: {done['difference']:.1e} of the largest logit")
    if int8:
        scanned = counted(done["scans"], "scan")
        output.say(f"int8: {done['equal_labels']:.2%} of the labels of {scanned} equal")
    output.say(f"export-onnx: {weights} → {target}")
