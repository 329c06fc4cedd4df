# SPDX-License-Identifier: MIT
"""Stage `export-onnx`: weights as an ONNX model with their card."""

from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.atomic import require_target, write_bytes
from salsanext_cli.io.weights.card_file import ONNX_SUFFIX
from salsanext_cli.io.weights.onnx_export import OPSET, difference, exported
from salsanext_cli.io.weights.weights import read_weights


def export_onnx(
    weights: Path,
    target: Path,
    *,
    view: Sensor | None = None,
    dynamic_width: bool = False,
    overwrite: bool = False,
) -> dict[str, Any]:
    """Write weights as an ONNX model of normalised range images to logits.

    Parameters
    ----------
    weights, target : Path
        Weights file, and ONNX model to write.
    view : Sensor, optional
        Sensor of the images, with its intensity matched to that of the weights; default: the
        sensor of the weights.
    dynamic_width, overwrite : bool
        Accept any width that is a multiple of the stride; replace an existing target.

    Returns
    -------
    dict
        Shapes, opset and size of the model, and `difference`, the largest difference from torch
        relative to the largest logit; None where ONNX Runtime is not installed.

    Raises
    ------
    WeightsError
        If the weights cannot be used, or the model computes different logits.
    MissingDependency
        If the package onnx is not installed.
    """
    import_extra("onnx", "onnx")
    module, card = read_weights(weights)
    if view is not None:
        trained = card.sensor.intensity_quantiles
        card = replace(card, sensor=replace(view, intensity_quantiles=trained))
    require_target(target, overwrite, ONNX_SUFFIX)
    content = exported(module, card, dynamic_width=dynamic_width).SerializeToString()
    width = "any" if dynamic_width else card.sensor.width
    report = {
        "stage": "export-onnx",
        "opset": OPSET,
        "input": [1, 5, card.sensor.height, width],
        "output": [1, card.space.class_count, card.sensor.height, width],
        "difference": difference(content, module, card) if find_spec("onnxruntime") else None,
        "bytes": len(content),
    }
    write_bytes(target, content, durable=True)
    return report
