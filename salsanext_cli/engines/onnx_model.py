# SPDX-License-Identifier: MIT
"""Network that OpenVINO reads from an ONNX file: labels and probabilities, without torch."""

import hashlib
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.compiled.kernels import thread_count
from salsanext_cli.engines.device import choose_engine, choose_precision, openvino_core
from salsanext_cli.engines.graphs import Graph, compiled_graph
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import MissingDependency, UsageError, WeightsError, error_text
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.user_cache import check_once
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.records import CHANNELS, Float, RangeImage
from salsanext_cli.sensors.sensor import Sensor

if TYPE_CHECKING:
    import openvino

    from salsanext_cli.network.segmentation import SegmentationNetwork


@dataclass(frozen=True, eq=False)
class OnnxNetwork(Network):
    """Network of an ONNX file; it has no module in torch."""

    path: Path = Path()

    def logits(self, image: RangeImage) -> Float:
        """Return the logits of every pixel, (C, H, W) float32."""
        (logits,) = self._compiled(None)(self.input_array(image.channels))
        of_one: Float = logits[0]
        return of_one

    def card_probabilities(
        self, channels: Sequence[Float], temperature: float | None = None
    ) -> list[Float]:
        """Return the softmax of every pixel of some range images, (C, H, W) float32 each."""
        compiled = self._compiled(temperature or self.card.temperature)
        return [compiled(self.input_array(image))[0][0] for image in channels]

    def model(self, temperature: float | None = None) -> "openvino.Model":
        """Read the file; with a temperature, for the softmax of the logits divided by it."""
        try:
            content = self.path.read_bytes()
        except OSError as error:
            raise WeightsError(self.path, f"cannot be read: {error_text(error)}") from error
        if hashlib.sha256(content).hexdigest() != self.sha256:
            found = "was replaced since the run began"
            raise WeightsError(self.path, found, "the same file", "run again with --overwrite")
        model = read_model(content, self.path, self.card, self.sensor)
        return model if temperature is None else with_softmax(model, temperature)

    def _compiled(self, temperature: float | None) -> Graph:
        threads = thread_count()
        place = (temperature, threads, threading.get_ident())
        if place not in self._graphs:
            key = ("ONNX", temperature, self.sha256, self.sensor.height, self.sensor.width)
            made = compiled_graph(lambda: self.model(temperature), key, self.precision, threads)
            self._graphs[place] = made
        return self._graphs[place]


def load_onnx(
    path: Path, card: WeightsCard, device: str, sensor: Sensor, precision: str, engine: str
) -> OnnxNetwork:
    """Load an ONNX file that `export-onnx` wrote; parameters and errors as of `load_network`."""
    if device not in ("auto", "cpu"):
        raise UsageError("--device", f"{device} for an ONNX model", "cpu, or .safetensors weights")
    if engine == "torch":
        raise UsageError("--engine", "torch for an ONNX model", "openvino, or .safetensors weights")

    def no_module() -> "SegmentationNetwork":
        from salsanext_cli.network.weights import read_weights

        return read_weights(path)[0]  # raises what is to be said

    network = OnnxNetwork(
        no_module,
        card,
        sensor,
        "cpu",
        choose_precision(precision, "cpu"),
        _openvino(),
        str(path),
        fingerprint(path),
        path=path,
    )
    import openvino

    size = f"{sensor.height}x{sensor.width}"
    check_once(f"{network.sha256}.{size}-{openvino.__version__}", network.model)
    return network


def _openvino() -> str:
    try:
        return choose_engine("openvino", "cpu")
    except MissingDependency as error:
        remedy = "install it again, or give the .safetensors weights"
        raise MissingDependency(error.subject, error.found, remedy=remedy) from error


def read_model(
    content: bytes, source: object, card: WeightsCard, sensor: Sensor
) -> "openvino.Model":
    """Read an ONNX model of normalised range images (1, 5, H, W) to logits (1, C, H, W).

    `content`: of the file; `source`: name of the file, for errors; `card`: with C classes;
    `sensor`: h and W; a model of dynamic width takes its width.
    """
    import openvino

    size = (sensor.height, sensor.width)
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
