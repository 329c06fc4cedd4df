# SPDX-License-Identifier: MIT
"""Parts of a network as OpenVINO graphs: traced once, compiled for this CPU, stored in the cache.

OpenVINO's front end converts the torch module in this process, without the command-line converter,
which reports its use. A graph in the cache is loaded without torch.
"""

import hashlib
import re
import threading
import warnings
from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import numpy as np

from salsanext_cli.engines.device import openvino_core, processor
from salsanext_cli.errors import OutputError, error_text, out_of_memory
from salsanext_cli.files.locks import temporary_folder
from salsanext_cli.files.user_cache import cached, store
from salsanext_cli.records import CHANNELS, Float
from salsanext_cli.version import __version__

GRAPH_VERSION = 1  # Raise it when the network or the code that makes graphs changes
HINTS = {"float32": "f32", "bfloat16": "bf16", "int8": "f32"}  # Of layers without ranges
LOGITS = "logits"  # Name of the last convolution, in every architecture
PRECISE = "precise_0"  # Mark of a layer that stays float32
NO_LAYERS = ("Constant", "Parameter", "Result")
OF_LOGITS = re.compile(rf"[./]{LOGITS}/")  # In the names of its layers
ERFC = (
    *(0.17087277, -0.82215223, 1.48851587, -1.13520398, 0.27886807),
    *(-0.18628806, 0.09678418, 0.37409196, 1.00002368, -1.26551223),
)
"""ln(erfc(x)/t) + x² in t = 1/(1 + x/2), highest power first (Numerical Recipes, 1992, 6.2)."""
_COMPILING = threading.Lock()  # For one thread at a time, because tracing has global state


class Graph:
    """Compiled part of a network: float32 arrays in, float32 arrays out, reproducible bits."""

    def __init__(self, compiled: Any) -> None:
        self.compiled = compiled
        self.request = compiled.create_infer_request()

    @property
    def shapes(self) -> list[tuple[int, ...]]:
        """Shapes of the inputs."""
        return [tuple(port.shape) for port in self.compiled.inputs]

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
    """Return a compiled model, from the cache if possible; else `make` returns the model.

    The `repr` of `key` identifies the model. The layers of the range image and of the logits
    compute in float32 in any precision. `threads` in all compute `streams` calls in parallel,
    which do not change a bit.
    """
    import openvino

    hints = {
        "INFERENCE_PRECISION_HINT": HINTS[precision],
        "INFERENCE_NUM_THREADS": threads,
        "NUM_STREAMS": streams,
    }
    core = openvino_core()

    def compile_model() -> bytes:
        model = make()
        if precision == "bfloat16":
            model = partly_float32(core, model)
        blob: BytesIO = core.compile_model(model, "CPU", hints).export_model()
        return blob.getvalue()

    made_by = (__version__, GRAPH_VERSION, openvino.__version__)
    depends = repr((key, precision, *made_by, processor()))
    name = f"graphs/{hashlib.sha256(depends.encode()).hexdigest()[:32]}.blob"
    with _COMPILING:
        content = cached(name, compile_model)
        try:
            return core.import_model(content, "CPU", hints)
        except RuntimeError as error:
            if out_of_memory(error):
                raise
            # Another build of the same version of OpenVINO compiled it.
            return core.import_model(store(name, compile_model()), "CPU", hints)


def converted(module: Any, function: Callable[..., Any], inputs: Sequence[Any]) -> Any:
    """Return ``function(module, *inputs)`` as a graph for inputs of these shapes."""
    import torch
    from openvino.frontend import FrontEndManager
    from openvino.frontend.pytorch import ConversionExtension
    from openvino.frontend.pytorch.ts_decoder import TorchScriptPythonDecoder

    class Function(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.module = module

        def forward(self, *tensors: torch.Tensor) -> Any:
            return function(self.module, *tensors)

    with torch.inference_mode(), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Sizes become constants, as intended.
        traced = torch.jit.trace(Function().eval(), tuple(inputs), check_trace=False)  # type: ignore[no-untyped-call]
        front_end = FrontEndManager().load_by_framework("pytorch")
        front_end.add_extension(ConversionExtension("aten::special_erfc", _erfc))
        decoder = TorchScriptPythonDecoder(traced, example_input=tuple(inputs))
        model = front_end.convert(front_end.load(decoder))
    shapes = (list(tensor.shape) for tensor in inputs)
    model.reshape(dict(zip(model.inputs, shapes, strict=True)))
    return model


def _erfc(node: Any) -> Any:
    """Translate erfc of numbers ≥ 0, for which OpenVINO has no operation."""
    from openvino import opset13 as ops

    def number(value: float) -> Any:
        return ops.constant(np.float32(value))

    x = node.get_input(0)
    t = ops.divide(number(1), ops.add(ops.multiply(x, number(0.5)), number(1)))
    power = number(ERFC[0])
    for coefficient in ERFC[1:]:
        power = ops.add(ops.multiply(power, t), number(coefficient))
    return ops.multiply(t, ops.exp(ops.subtract(power, ops.multiply(x, x)))).outputs()


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
        with temporary_folder() as folder:
            file = folder / "model.xml"
            openvino.save_model(model, file, compress_to_fp16=False)
            return core.read_model(file.read_bytes(), file.with_suffix(".bin").read_bytes())
    except (OSError, RuntimeError) as error:
        problem, hint = f"cannot store the network: {error_text(error)}", "free some space"
        raise OutputError("folder for temporary files", problem, hint=hint) from error
