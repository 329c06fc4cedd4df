# SPDX-License-Identifier: MIT
"""Stage `export-onnx`: weights as an ONNX model with their card."""

from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import CHANNELS
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.atomic import require_target, write_target
from salsanext_cli.io.weights.card_file import ONNX_SUFFIX
from salsanext_cli.io.weights.onnx_export import OPSET, largest_difference, onnx_model
from salsanext_cli.io.weights.weights import read_weights


@dataclass(frozen=True, slots=True, kw_only=True)
class OnnxReport:
    """ONNX model that was written."""

    opset: int
    class_count: int
    height: int  # Of the range images, pixels
    width: int | None  # Of the range images, pixels; None for any
    # Largest difference from torch, relative to the largest logit; None without ONNX Runtime
    difference: float | None
    size: int  # Of the file, bytes

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, with the shapes of input and output."""
        width = "any" if self.width is None else self.width
        return {
            "stage": "export-onnx",
            "opset": self.opset,
            "input": [1, len(CHANNELS), self.height, width],
            "output": [1, self.class_count, self.height, width],
            "difference": self.difference,
            "bytes": self.size,
        }


def export_onnx(
    weights: Path,
    target: Path,
    *,
    sensor: Sensor | None = None,
    dynamic_width: bool = False,
    overwrite: bool = False,
) -> OnnxReport:
    """Write weights as an ONNX model of normalised range images to logits.

    Parameters
    ----------
    weights : Path
        Weights file.
    target : Path
        ONNX model to write.
    sensor : Sensor, optional
        Sensor of the images; the intensity quantiles stay those of the weights. Default: the
        sensor of the weights.
    dynamic_width : bool
        Whether the model accepts any width that is a multiple of the stride.
    overwrite : bool
        Whether to replace an existing target.

    Returns
    -------
    OnnxReport

    Raises
    ------
    WeightsError
        If the weights cannot be used, or the model computes different logits.
    MissingDependency
        If the package onnx is not installed.
    OutputError
        If the target cannot be written, or may not replace another file.
    """
    import_extra("onnx", "onnx")
    require_target(target, overwrite, ONNX_SUFFIX)
    module, card = read_weights(weights)
    if sensor is not None:
        trained = card.sensor.intensity_quantiles
        card = replace(card, sensor=replace(sensor, intensity_quantiles=trained))
    content = onnx_model(module, card, dynamic_width=dynamic_width).SerializeToString()
    can_compare = find_spec("onnxruntime") is not None
    difference = largest_difference(content, module, card) if can_compare else None
    report = OnnxReport(
        opset=OPSET,
        class_count=card.space.class_count,
        height=card.sensor.height,
        width=None if dynamic_width else card.sensor.width,
        difference=difference,
        size=len(content),
    )
    write_target(target, content, overwrite=overwrite)
    return report
