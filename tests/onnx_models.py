# SPDX-License-Identifier: MIT
"""ONNX models of a single layer."""

from collections.abc import Mapping
from pathlib import Path

import pytest


def write_onnx(path: Path, metadata: Mapping[str, str], opset: int = 17) -> Path:
    """Write a model with metadata, by the package onnx."""
    onnx = pytest.importorskip("onnx")
    helper = onnx.helper
    ports = [helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, [1, 2]) for name in "xy"]
    graph = helper.make_graph([helper.make_node("Relu", "x", "y")], "g", ports[:1], ports[1:])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)])
    helper.set_model_props(model, dict(metadata))
    path.parent.mkdir(parents=True, exist_ok=True)
    onnx.save(model, path)
    return path
