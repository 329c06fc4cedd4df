# SPDX-License-Identifier: MIT
"""Engine that OpenVINO reads from an ONNX file: labels and probabilities, without torch."""

import hashlib
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.compiled.kernels import thread_count
from salsanext_cli.engines.device import choose_engine, choose_precision, openvino_core
from salsanext_cli.engines.engine import Engine
from salsanext_cli.engines.graphs import Graph, compiled_graph
from salsanext_cli.errors import MissingDependency, UsageError, WeightsError, error_text
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.user_cache import check_once
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.records import CHANNELS

if TYPE_CHECKING:
    import openvino

    from salsanext_cli.network.segmentation import SegmentationNetwork


@dataclass(frozen=True, eq=False)
class OnnxEngine(Engine):
    """Engine of an ONNX file; it has no module in torch."""

    path: Path = Path()

    def model(self, temperature: float | None = None) -> "openvino.Model":
        """Read the file; with a temperature, for the softmax of the logits divided by it."""
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise WeightsError(self.path, f"cannot be read: {error_text(error)}") from error
        if hashlib.sha256(content).hexdigest() != self.sha256:
            found = "was replaced since the run began"
            raise WeightsError(self.path, found, "the same file", "run again with --overwrite")
        model = read_model(content, self.path, self.card, self.size)
        return model if temperature is None else with_softmax(model, temperature)

    def output_graph(self, temperature: float | None) -> Graph:
        """Return the graph of the softmax at a temperature, or of the logits."""
        threads = thread_count()
        place = (temperature, threads, threading.get_ident())
        if place not in self.graphs:
            key = ("ONNX", temperature, self.sha256, *self.size)
            made = compiled_graph(lambda: self.model(temperature), key, self.precision, threads)
            self.graphs[place] = made
        return self.graphs[place]


def load_onnx(
    path: Path,
    card: WeightsCard,
    size: tuple[int, int],
    device: str,
    precision: str,
    engine: str,
) -> OnnxEngine:
    """Load an ONNX file that `export-onnx` wrote; parameters and errors as of `load_network`."""
    if device not in ("auto", "cpu"):
        raise UsageError("--device", f"{device} for an ONNX model", "cpu, or .safetensors weights")
    if engine == "torch":
        raise UsageError("--engine", "torch for an ONNX model", "openvino, or .safetensors weights")

    def no_module() -> "SegmentationNetwork":
        from salsanext_cli.network.weights import read_weights

        return read_weights(path)[0]  # raises what is to be said

    loaded = OnnxEngine(
        no_module,
        card,
        size,
        "cpu",
        choose_precision(precision, "cpu"),
        _openvino(),
        str(path),
        fingerprint(path),
        path=path,
    )
    import openvino

    shape = "x".join(map(str, size))
    check_once(f"{loaded.sha256}.{shape}-{openvino.__version__}", loaded.model)
    return loaded


def _openvino() -> str:
    try:
        return choose_engine("openvino", "cpu")
    except MissingDependency as error:
        remedy = "install it again, or give the .safetensors weights"
        raise MissingDependency(error.subject, error.found, remedy=remedy) from error


def read_model(
    content: bytes, source: object, card: WeightsCard, size: tuple[int, int]
) -> "openvino.Model":
    """Read an ONNX model of normalised range images (1, 5, H, W) to logits (1, C, H, W).

    `content`: of the file; `source`: name of the file, for errors; `card`: with C classes;
    `size`: H and W; a model of dynamic width takes this width.
    """
    import openvino

    wanted = [1, len(CHANNELS), *size]
    try:
        model = openvino_core().read_model(content)
        shapes = [port.get_partial_shape() for port in (*model.inputs, *model.outputs)]
        if len(model.inputs) != 1 or len(model.outputs) != 1:
            count = f"{len(model.inputs)} inputs and {len(model.outputs)} outputs"
            raise WeightsError(source, count, "one of each")
        if not shapes[0].compatible(openvino.PartialShape(wanted)):
            remedy = "export it again with --sensor, or with --dynamic-width"
            raise WeightsError(source, f"takes images {shapes[0]}", f"{wanted}", remedy)
        model.reshape(wanted)
    except (RuntimeError, ValueError, TypeError, MemoryError) as error:
        found = f"cannot be read by OpenVINO: {error_text(error)}"
        remedy = "write it with `salsanext export-onnx`"
        raise WeightsError(source, found, "an ONNX model", remedy) from error
    found, expected = model.output(0).get_partial_shape(), [1, card.space.class_count, *size]
    if found != openvino.PartialShape(expected):
        raise WeightsError(source, f"its logits are {found}", f"{expected}, as its card says")
    return model


def with_softmax(model: "openvino.Model", temperature: float) -> "openvino.Model":
    """Return the model that ends with the softmax of its logits divided by a temperature."""
    import openvino
    from openvino import opset13 as ops

    logits = model.output(0).get_node().input_value(0)
    scaled = ops.divide(logits, ops.constant(np.float32(temperature)))
    return openvino.Model([ops.softmax(scaled, 1)], model.get_parameters(), "softmax")
