# SPDX-License-Identifier: MIT
"""ONNX models in int8: NNCF finds the range of every feature map from images without labels."""

import io
import logging
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from typing import TYPE_CHECKING, Any

import numpy as np

from salsanext_cli.engines.graphs import LOGITS
from salsanext_cli.engines.onnx_export import INPUT
from salsanext_cli.files.optional_packages import import_nncf
from salsanext_cli.records import CHANNELS, Float

if TYPE_CHECKING:
    import onnx

SHIFT = 128
"""From signed to unsigned bytes."""


def quantised(
    model: "onnx.ModelProto", scans: Sequence[Any], image_of: Callable[[Any], Float]
) -> "onnx.ModelProto":
    """Return a model whose convolutions multiply bytes.

    Float32 stay the first part of the network, which sees ranges of 0 to 80 metres to the
    centimetre, and the logits. The ranges of feature maps are means over the scans of high and low
    quantiles, not extremes.

    `model`: from `exported`; left as it is; `scans`: for calibration; `image_of`: returns the
    normalised image of one of them, (1, 5, H, W) float32.
    """
    nncf = import_nncf()
    from nncf.quantization.range_estimator import RangeEstimatorParametersSet

    logging.getLogger("nncf").setLevel(logging.ERROR)
    dataset = nncf.Dataset(scans, lambda scan: {INPUT: image_of(scan)})
    with redirect_stdout(io.StringIO()):  # bars of progress
        found: onnx.ModelProto = nncf.quantize(
            model,
            dataset,
            preset=nncf.QuantizationPreset.MIXED,
            subset_size=len(scans),
            ignored_scope=nncf.IgnoredScope(names=left_in_float32(model), validate=False),
            advanced_parameters=nncf.AdvancedQuantizationParameters(
                activations_range_estimator_params=RangeEstimatorParametersSet.MEAN_QUANTILE
            ),
        )
    _make_unsigned(found)
    return found


def left_in_float32(model: "onnx.ModelProto") -> list[str]:
    """Return the names of the nodes of the part that sees the range image, and of the logits."""
    channels = {
        tensor.name: tensor.dims[1] for tensor in model.graph.initializer if tensor.dims[1:]
    }
    parts = {LOGITS}
    for node in model.graph.node:
        if node.op_type == "Conv" and channels.get(node.input[1]) == len(CHANNELS):
            parts.add(_part(node.name))
    return [node.name for node in model.graph.node if _part(node.name) in parts]


def _part(name: str) -> str:
    """Return the part of the network in the name of a node, such as ``/context/…/Conv``."""
    return name.split("/")[1] if "/" in name else ""


def _make_unsigned(model: "onnx.ModelProto") -> None:
    """Let feature maps be unsigned bytes: the same values.

    OpenVINO 2026.4 computes convolutions of concatenated signed ones wrongly on x86.
    """
    from onnx import numpy_helper

    nodes = [node for node in model.graph.node if node.op_type == "QuantizeLinear"]
    zeros = {node.input[2] for node in nodes}
    for tensor in model.graph.initializer:
        if tensor.name in zeros:
            shifted = numpy_helper.to_array(tensor).astype(np.int16) + SHIFT
            tensor.CopyFrom(numpy_helper.from_array(shifted.astype(np.uint8), tensor.name))
    del model.graph.value_info[:]  # with the types from before
