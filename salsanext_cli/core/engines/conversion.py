# SPDX-License-Identifier: MIT
"""Conversion of a torch module to an OpenVINO graph.

This is the only module that uses `torch.jit.trace`, which torch deprecates, and the front end of
OpenVINO, which converts in this process. OpenVINO's converter for users reports its use.
"""

import warnings
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

# fmt: off
ERFC = (
    0.17087277, -0.82215223, 1.48851587, -1.13520398, 0.27886807,
    -0.18628806, 0.09678418, 0.37409196, 1.00002368, -1.26551223,
)
# fmt: on
"""ln(erfc(x)/t) + x² in t = 1/(1 + x/2), highest power first (Numerical Recipes, 1992, 6.2)."""


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
