# SPDX-License-Identifier: MIT
"""Networks as ONNX models: written by torch, compared with it by ONNX Runtime."""

import io
import logging
import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.engines.graphs import LOGITS
from salsanext_cli.errors import WeightsError
from salsanext_cli.files.locks import temporary_folder
from salsanext_cli.files.optional_packages import import_extra, import_nncf
from salsanext_cli.network.card import WeightsCard
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import CHANNELS, Float

OPSET = 17  # The latest that TensorRT 8.6 reads; OpenVINO and ONNX Runtime read later ones too
INPUT, OUTPUT = "image", "logits"
TOLERANCE = 1e-3  # Largest difference from torch, relative to the largest logit
SHIFT = 128  # From signed to unsigned bytes


class _Traced(nn.Module):
    """A network for images of one height, and for every width where nothing is to be padded."""

    def __init__(self, module: SegmentationNetwork, height: int, width: int) -> None:
        super().__init__()
        self.module = module
        self.height, self.width = height, width
        self.columns = torch.arange(width + -width % module.stride[1]) % width
        self.rows = -height % module.stride[0]

    def forward(self, image: Tensor) -> Tensor:
        if len(self.columns) != self.width:
            image = image[..., self.columns]
        if self.rows:
            image = nn.functional.pad(image, (0, 0, 0, self.rows))
        logits: Tensor = self.module.rest(*self.module.trunk(image))
        if self.rows:
            logits = logits[..., : self.height, :]
        return logits[..., : self.width] if len(self.columns) != self.width else logits


def exported(module: SegmentationNetwork, card: WeightsCard, *, dynamic_width: bool = False) -> Any:
    """Return a network as an ONNX model, for one width or for every multiple of its stride."""
    package = import_extra("onnx", "onnx")
    height, width = card.sensor.height, card.sensor.width
    if dynamic_width:
        width += -width % module.stride[1]
    traced = _Traced(module, height, width)
    example = torch.zeros(1, len(CHANNELS), height, width)
    axes = {name: {3: "width"} for name in (INPUT, OUTPUT)} if dynamic_width else None
    with warnings.catch_warnings(), torch.inference_mode(), temporary_folder() as folder:
        # The exporter that needs no further package; and sizes become constants, as they should.
        warnings.simplefilter("ignore")
        file = folder / "model.onnx"
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
        model = package.load_model(file)
    package.helper.set_model_props(model, card.to_metadata())
    return model


def run(content: bytes, images: list[Float]) -> list[Float]:
    """Compute logits (1, C, H, W) of images (1, 5, H, W) by ONNX Runtime."""
    onnxruntime: Any = import_extra("onnxruntime", "onnx")
    onnxruntime.disable_telemetry_events()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    return [session.run([OUTPUT], {INPUT: image})[0] for image in images]


def difference(content: bytes, module: SegmentationNetwork, card: WeightsCard) -> float:
    """Return the largest difference from torch's logits, relative to the largest, of two images."""
    size = (1, len(CHANNELS), card.sensor.height, card.sensor.width)
    images = [
        np.random.default_rng(0).standard_normal(size, np.float32),
        np.zeros(size, np.float32),
    ]
    largest = 0.0
    for image, logits in zip(images, run(content, images), strict=True):
        with torch.inference_mode():
            expected = module(torch.from_numpy(image)).numpy()
        error = np.abs(logits - expected).max() / np.abs(expected).max()
        if not error <= TOLERANCE:
            wrong = f"ONNX Runtime's logits differ from torch's by {error:.2g}"
            raise WeightsError("the ONNX model", wrong, f"at most {TOLERANCE:g}")
        largest = max(largest, float(error))
    return largest


def quantised(model: Any, scans: Sequence[Any], image_of: Callable[[Any], Float]) -> Any:
    """Return a model from `exported` whose convolutions multiply bytes."""
    # Float32 stay the first part of the network, which sees ranges of 0 to 80 metres to the
    # centimetre, and the logits. The ranges of feature maps are means over the scans of high and
    # low quantiles, not extremes; `image_of` returns the normalised image (1, 5, H, W) of a scan.
    nncf = import_nncf()
    from nncf.quantization.range_estimator import RangeEstimatorParametersSet

    logging.getLogger("nncf").setLevel(logging.ERROR)
    dataset = nncf.Dataset(scans, lambda scan: {INPUT: image_of(scan)})
    with redirect_stdout(io.StringIO()):  # bars of progress
        short = nncf.quantize(
            model,
            dataset,
            preset=nncf.QuantizationPreset.MIXED,
            subset_size=len(scans),
            ignored_scope=nncf.IgnoredScope(names=left_in_float32(model), validate=False),
            advanced_parameters=nncf.AdvancedQuantizationParameters(
                activations_range_estimator_params=RangeEstimatorParametersSet.MEAN_QUANTILE
            ),
        )
    _make_unsigned(short)
    return short


def left_in_float32(model: Any) -> list[str]:
    """Return the names of the nodes of the part that sees the range image, and of the logits."""
    channels = {each.name: each.dims[1] for each in model.graph.initializer if each.dims[1:]}
    parts = {LOGITS}
    for node in model.graph.node:
        if node.op_type == "Conv" and channels.get(node.input[1]) == len(CHANNELS):
            parts.add(_part(node.name))
    return [node.name for node in model.graph.node if _part(node.name) in parts]


def _part(name: str) -> str:
    """Return the part of the network in the name of a node, such as ``/context/…/Conv``."""
    return name.split("/")[1] if "/" in name else ""


def _make_unsigned(model: Any) -> None:
    """Let feature maps be unsigned bytes of the same values."""
    # OpenVINO 2026.4 computes convolutions of concatenated signed ones wrongly on x86.
    from onnx import numpy_helper

    nodes = [node for node in model.graph.node if node.op_type == "QuantizeLinear"]
    zeros = {node.input[2] for node in nodes}
    for tensor in model.graph.initializer:
        if tensor.name in zeros:
            shifted = numpy_helper.to_array(tensor).astype(np.int16) + SHIFT
            tensor.CopyFrom(numpy_helper.from_array(shifted.astype(np.uint8), tensor.name))
    del model.graph.value_info[:]  # with the types from before
