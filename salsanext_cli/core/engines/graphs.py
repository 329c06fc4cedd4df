# SPDX-License-Identifier: MIT
"""Parts of a network as OpenVINO graphs: perhaps in int8, compiled and stored.

A graph in the cache is loaded without torch.
"""

import hashlib
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from io import BytesIO
from typing import Any

import numpy as np

from salsanext_cli.core import caches
from salsanext_cli.core.engines.backend import LOGITS
from salsanext_cli.core.engines.device import float_of_precision, processor
from salsanext_cli.core.engines.memory import out_of_memory
from salsanext_cli.core.engines.openvino_runtime import openvino_core
from salsanext_cli.core.errors import OutputError, WeightsError
from salsanext_cli.core.network.int8_inputs import LEVELS, Int8Input
from salsanext_cli.core.records import CHANNELS, Float
from salsanext_cli.core.texts import error_text
from salsanext_cli.version import __version__

GRAPH_VERSION = 2  # Raise it when the network or the code that makes graphs changes
HINTS = {"float32": "f32", "bfloat16": "bf16"}
PRECISE = "precise_0"  # Mark of a layer that stays float32
NO_LAYERS = ("Constant", "Parameter", "Result")
OF_LOGITS = re.compile(rf"[./]{LOGITS}/")  # In the names of its layers
PREFIX = "__module.module."  # Of the names of layers in a converted graph
WEIGHT_LEVELS = 255  # Symmetric
HEADROOM = 127 / 64
"""Weights have integers up to 64. CPUs without VNNI add products in pairs and clip the sums to 16
bits, which 2 · 255 · 64 does not exceed. With AMX, weights have integers up to 127."""
_COMPILING = threading.Lock()  # For one thread at a time, because tracing has global state


class Graph:
    """Compiled part of a network: float32 arrays in, float32 arrays out, reproducible bits."""

    def __init__(self, compiled: Any) -> None:
        self.compiled = compiled
        self.request = compiled.create_infer_request()

    def __call__(self, *inputs: Float, share: bool = False) -> list[Float]:
        """Compute once; shared outputs are overwritten by the next call of this graph."""
        numbered = dict(enumerate(inputs))
        outputs = self.request.infer(numbered, share_inputs=True, share_outputs=share)
        return list(outputs.values())

    def in_parallel(self, calls: Sequence[Sequence[Float]]) -> list[list[Float]]:
        """Compute several calls in parallel; return the outputs in their order."""
        from openvino import AsyncInferQueue

        outputs: list[list[Float]] = [[]] * len(calls)

        def copy_outputs(request: Any, number: int) -> None:
            outputs[number] = [tensor.data.copy() for tensor in request.output_tensors]

        queue = AsyncInferQueue(self.compiled)
        queue.set_callback(copy_outputs)
        for number, inputs in enumerate(calls):
            queue.start_async(dict(enumerate(inputs)), number, share_inputs=True)
        queue.wait_all()
        return outputs


def compiled_graph(
    make: Callable[[], Any],
    key: object,
    precision: str = "float32",
    threads: int = 1,
    streams: int = 1,
) -> Any:
    """Return a compiled model, from the cache if possible.

    The layers of the range image and of the logits compute in float32 in any precision. In int8,
    other layers without ranges compute in the float of `float_of_precision`.

    Parameters
    ----------
    make : callable
        Returns the model; called if the cache does not have it.
    key : object
        Identifies the model by its `repr`.
    precision : {"float32", "bfloat16", "int8"}
        Number type of most layers.
    threads : int
        Number of threads in all.
    streams : int
        Number of calls that they compute in parallel; the results are the same.

    Returns
    -------
    openvino.CompiledModel
    """
    import openvino

    float_type = float_of_precision(precision)
    hints = {
        "INFERENCE_PRECISION_HINT": HINTS[float_type],
        "INFERENCE_NUM_THREADS": threads,
        "NUM_STREAMS": streams,
    }
    core = openvino_core()

    def compile_model() -> bytes:
        model = make()
        if float_type == "bfloat16":
            model = partly_float32(core, model)
        blob: BytesIO = core.compile_model(model, "CPU", hints).export_model()
        return blob.getvalue()

    versions = (__version__, GRAPH_VERSION, openvino.__version__)
    depends = repr((key, precision, float_type, *versions, processor()))
    name = f"graphs/{hashlib.sha256(depends.encode()).hexdigest()[:32]}.blob"
    with _COMPILING:
        content = caches.used().cached(name, compile_model)
        try:
            return core.import_model(content, "CPU", hints)
        except RuntimeError as error:
            if out_of_memory(error):
                raise
            # Another build of the same version of OpenVINO compiled it.
            return core.import_model(caches.used().store(name, compile_model()), "CPU", hints)


def partly_float32(core: Any, model: Any) -> Any:
    """Return a model whose layers of the range image, of the logits and after them are float32."""
    # Otherwise bfloat16 would round ranges to the metre. OpenVINO ignores the marks of a model in
    # memory, so the model is written and read.
    import openvino

    after_logits = False
    for node in model.get_ordered_ops():
        if node.get_type_name() in ("Convolution", "GroupConvolution"):
            is_logits = bool(OF_LOGITS.search(node.get_friendly_name()))
            after_logits |= is_logits
            channels = node.input(0).get_partial_shape()[1].get_length()
            precise = is_logits or channels == len(CHANNELS)
        else:
            precise = after_logits and node.get_type_name() not in NO_LAYERS
        if precise:
            node.get_rt_info()[PRECISE] = ""
    try:
        with caches.used().temporary_folder() as folder:
            file = folder / "model.xml"
            openvino.save_model(model, file, compress_to_fp16=False)
            return core.read_model(file.read_bytes(), file.with_suffix(".bin").read_bytes())
    except (OSError, RuntimeError) as error:
        problem = f"cannot store the network: {error_text(error)}"
        hint = "free some space"
        raise OutputError("folder for temporary files", problem, hint=hint) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class InputBytes:
    """Bytes of the input of a layer in a graph: x = steps · (q - zero)."""

    steps: Float  # (1, C, 1, 1) float32
    lowest: int  # Of the 256 values of q
    zero: int = 0  # Which the graph takes back after the layer

    @classmethod
    def from_layer(cls, layer: Int8Input, *, tiles: bool, pads: bool) -> "InputBytes":
        """Return the bytes of a layer.

        Parameters
        ----------
        layer : Int8Input
            Quantisation of its input.
        tiles : bool
            Whether the CPU multiplies tiles of bytes. It does so fast if the byte of 0 is 0.
        pads : bool
            Whether the layer pads its input, for which the byte of 0 must be 0.

        Returns
        -------
        InputBytes
        """
        steps = layer.steps.reshape(1, -1, 1, 1)
        if not tiles:
            return cls(steps=steps, lowest=-layer.zero)
        if not pads:
            return cls(steps=steps, lowest=0, zero=layer.zero)
        highest = LEVELS // 2 - 1
        wider = max(layer.zero / (LEVELS // 2), (LEVELS - 1 - layer.zero) / highest)
        return cls(steps=steps * np.float32(wider), lowest=-LEVELS // 2)

    def quantise(self, value: Any) -> Any:
        """Return q of an output of a graph, (1, C, H, W), as an output."""
        integers = (self.lowest, self.lowest + LEVELS - 1)
        limits = tuple((integer - self.zero) * self.steps for integer in integers)
        return _rounded(value, limits, integers, LEVELS)


def quantised(
    model: Any, inputs: Mapping[str, Int8Input], source: object, *, tiles: bool = False
) -> Any:
    """Quantise inputs and weights of the layers of a converted graph.

    Parameters
    ----------
    model : openvino.Model
        Graph, which is changed.
    inputs : mapping of str to Int8Input
        Quantisation of the inputs by name of the layer.
    source : object
        Name of the weights in errors.
    tiles : bool
        Whether the CPU multiplies tiles of bytes. The bits depend on it.

    Returns
    -------
    openvino.Model
        The graph.

    Raises
    ------
    WeightsError
        If the graph does not have one of the layers.
    """
    quantised_values: dict[Any, Any] = {}  # Several layers may have the same input
    changed: set[str] = set()
    for node in model.get_ordered_ops():
        name = node.get_friendly_name().partition("/")[0].removeprefix(PREFIX)
        if node.get_type_name() != "Convolution" or name not in inputs:
            continue
        layer = inputs[name]
        weights = node.input(1).get_source_output().get_node().get_data()
        if len(layer.shifts) != weights.shape[1]:
            break
        pads = any(node.get_attributes()["pads_begin"])
        in_bytes = InputBytes.from_layer(layer, tiles=tiles, pads=pads)
        value = node.input(0).get_source_output()
        key = (value.get_node().get_friendly_name(), value.get_index(), layer, pads and tiles)
        if key not in quantised_values:
            quantised_values[key] = in_bytes.quantise(value)
        node.input(0).replace_source_output(quantised_values[key])
        _quantise_weights(node, weights * in_bytes.steps, 1 if tiles else HEADROOM, in_bytes.zero)
        changed.add(name)
    missing = sorted(inputs.keys() - changed)
    if missing:
        problem = f"has int8 ranges of another network, such as of layer {missing[0]}"
        raise WeightsError(source, problem, hint="fit them again with `salsanext tune int8`")
    return model


def _quantise_weights(node: Any, weights: Float, headroom: float, zero: int) -> None:
    """Give a convolution weights (O, C, h, w) that are rounded; take the byte of 0 back."""
    from openvino import opset13 as ops

    most = headroom * np.abs(weights).max(axis=(1, 2, 3), keepdims=True)
    most = np.maximum(most, np.finfo(np.float32).tiny)
    limits = (-most, most)
    rounded = _rounded(ops.constant(weights), limits, limits, WEIGHT_LEVELS)
    node.input(1).replace_source_output(rounded)
    if not zero:
        return
    step = most / (WEIGHT_LEVELS // 2)
    sums = (np.rint(weights / step) * step).sum(axis=(1, 2, 3)).reshape(1, -1, 1, 1)
    targets = node.output(0).get_target_inputs()
    shifted = ops.subtract(node.output(0), _constant(zero * sums))
    for target in targets:
        target.replace_source_output(shifted.output(0))


def _constant(values: Any) -> Any:
    from openvino import opset13 as ops

    return ops.constant(np.asarray(values, np.float32))


def _rounded(value: Any, limits: Sequence[Any], integers: Sequence[Any], levels: int) -> Any:
    """Return an output rounded to levels between limits, which become the integers."""
    from openvino import opset13 as ops

    ends = map(_constant, (*limits, *integers))
    return ops.fake_quantize(value, *ends, levels).output(0)
