# SPDX-License-Identifier: MIT
"""Graphs that OpenVINO computes in 8-bit integers: bytes as inputs, signed bytes as weights."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from salsanext_cli.errors import WeightsError
from salsanext_cli.network.int8_inputs import LEVELS, Int8Input
from salsanext_cli.records import Float

PREFIX = "__module.module."  # Of the names of layers in a converted graph
WEIGHT_LEVELS = 255  # Symmetric
HEADROOM = 127 / 64
"""Weights have integers up to 64. CPUs without VNNI add products in pairs and clip the sums to 16
bits, which 2 · 255 · 64 does not exceed, so that all CPUs compute the same."""


def quantised(model: Any, inputs: Mapping[str, Int8Input], source: object) -> Any:
    """Quantise inputs and weights of the layers of a converted graph, and return the graph.

    A layer of `inputs` that the graph does not have raises `WeightsError` with the source.
    """
    from openvino import opset13 as ops

    def rounded(value: Any, limits: tuple[Float, Float], integers: tuple[Any, Any], n: int) -> Any:
        ends = [ops.constant(np.asarray(end, np.float32)) for end in (*limits, *integers)]
        return ops.fake_quantize(value, *ends, n).output(0)

    bytes_of: dict[Any, Any] = {}  # Of a value, since several layers may have the same input
    changed: set[str] = set()
    for node in model.get_ordered_ops():
        name = node.get_friendly_name().partition("/")[0].removeprefix(PREFIX)
        if node.get_type_name() != "Convolution" or name not in inputs:
            continue
        layer, value = inputs[name], node.input(0).get_source_output()
        weights = node.input(1).get_source_output().get_node().get_data()
        if len(layer.shifts) != weights.shape[1]:
            break
        key = (value.get_node().get_friendly_name(), value.get_index(), layer)
        steps, integers = layer.steps.reshape(1, -1, 1, 1), (-layer.zero, LEVELS - 1 - layer.zero)
        if key not in bytes_of:
            limits = (integers[0] * steps, integers[1] * steps)
            bytes_of[key] = rounded(value, limits, integers, LEVELS)
        scaled = weights * steps
        most = HEADROOM * np.abs(scaled).max(axis=(1, 2, 3), keepdims=True)
        most = np.maximum(most, np.finfo(np.float32).tiny)
        limits = (-most, most)
        node.input(0).replace_source_output(bytes_of[key])
        weights = rounded(ops.constant(scaled), limits, limits, WEIGHT_LEVELS)
        node.input(1).replace_source_output(weights)
        changed.add(name)
    if missing := sorted(inputs.keys() - changed):
        problem = f"has int8 ranges of another network, such as of layer {missing[0]}"
        raise WeightsError(source, problem, hint="fit them again with `salsanext tune int8`")
    return model
