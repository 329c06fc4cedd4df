# SPDX-License-Identifier: MIT
"""Networks as ONNX models: written by torch, checked with ONNX Runtime."""

import io
import warnings
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.records import CHANNELS, Float

OPSET = 17  # The latest that TensorRT 8.6 reads; OpenVINO and ONNX Runtime read later ones too
INPUT = "image"
OUTPUT = "logits"
TOLERANCE = 1e-3  # Largest difference from torch, relative to the largest logit


class _Traced(nn.Module):
    """A network for images of one height, and of any width that needs no padding."""

    def __init__(self, module: SegmentationNetwork, height: int, width: int) -> None:
        super().__init__()
        self.module = module
        self.height = height
        self.width = width
        self.columns = torch.arange(width + -width % module.stride[1]) % width
        self.rows = -height % module.stride[0]

    def forward(self, image: Tensor) -> Tensor:
        if len(self.columns) != self.width:
            image = image[..., self.columns]
        if self.rows:
            image = nn.functional.pad(image, (0, 0, 0, self.rows))
        features = self.module.trunk(image)
        logits: Tensor = self.module.rest(*features)
        if self.rows:
            logits = logits[..., : self.height, :]
        return logits[..., : self.width] if len(self.columns) != self.width else logits


def onnx_model(
    module: SegmentationNetwork, card: WeightsCard, *, dynamic_width: bool = False
) -> Any:
    """Return a network as an ONNX model.

    Parameters
    ----------
    module : SegmentationNetwork
        Network in torch.
    card : WeightsCard
        Its card, which the model contains.
    dynamic_width : bool
        Whether the model takes images of every multiple of the stride, not of one width.

    Returns
    -------
    onnx.ModelProto
    """
    package = import_extra("onnx", "onnx")
    height = card.sensor.height
    width = card.sensor.width
    if dynamic_width:
        width += -width % module.stride[1]
    traced = _Traced(module, height, width)
    example = torch.zeros(1, len(CHANNELS), height, width)
    axes = {name: {3: "width"} for name in (INPUT, OUTPUT)} if dynamic_width else None
    file: Any = io.BytesIO()
    with warnings.catch_warnings(), torch.inference_mode():
        # The exporter is deprecated but needs no package; sizes become constants, as intended.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            traced.eval(),
            (example,),
            file,
            input_names=[INPUT],
            output_names=[OUTPUT],
            opset_version=OPSET,
            dynamic_axes=axes,
            dynamo=False,
        )
    model = package.load_model_from_string(file.getvalue())
    package.helper.set_model_props(model, card.to_metadata())
    return model


def run(content: bytes, image: Float) -> Float:
    """Compute the logits (1, C, H, W) of an image (1, 5, H, W) by ONNX Runtime."""
    onnxruntime: Any = import_extra("onnxruntime", "onnx")
    onnxruntime.disable_telemetry_events()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return session.run([OUTPUT], {INPUT: image})[0]


def largest_difference(content: bytes, module: SegmentationNetwork, card: WeightsCard) -> float:
    """Compare the logits of ONNX Runtime with those of torch.

    Parameters
    ----------
    content : bytes
        ONNX model.
    module : SegmentationNetwork
        Network in torch.
    card : WeightsCard
        Its card.

    Returns
    -------
    float
        Largest difference, relative to the largest logit.

    Raises
    ------
    WeightsError
        If it exceeds `TOLERANCE`.
    """
    size = (1, len(CHANNELS), card.sensor.height, card.sensor.width)
    image = np.random.default_rng(0).standard_normal(size, np.float32)
    with torch.inference_mode():
        expected = module(torch.from_numpy(image)).numpy()
    error = float(np.abs(run(content, image) - expected).max() / np.abs(expected).max())
    if not error <= TOLERANCE:
        problem = f"the logits of ONNX Runtime differ from torch by {error:.2g}"
        raise WeightsError("ONNX model", problem, f"at most {TOLERANCE:g}")
    return error
