# SPDX-License-Identifier: MIT
"""Ranges of the inputs of layers, for networks that compute in 8-bit integers."""

from collections.abc import Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor, nn

from salsanext_cli.core.engines.backend import LOGITS
from salsanext_cli.core.network.int8_inputs import Int8Input
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS, Float

OUTLIERS = 1e-4  # Share of the values of a channel beyond each end of its range
MAX_PIXELS = 32768  # Pixels of a channel that are compared


def int8_layers(module: SegmentationNetwork) -> dict[str, nn.Conv2d]:
    """Return the convolutions that can compute in 8-bit integers, by name."""
    precise = (LOGITS, *module.precise)
    return {
        name: layer
        for name, layer in module.named_modules()
        if isinstance(layer, nn.Conv2d)
        and layer.groups == 1
        and layer.in_channels != len(CHANNELS)
        and name.partition(".")[0] not in precise
    }


@torch.inference_mode()
def int8_inputs(module: SegmentationNetwork, inputs: Sequence[Float]) -> dict[str, Int8Input]:
    """Return ranges of the inputs of layers: means over images (1, 5, H, W) float32."""
    layers = int8_layers(module)
    ends: dict[str, list[Float]] = {name: [] for name in layers}

    def measure(name: str, _: nn.Module, arguments: tuple[Tensor, ...]) -> None:
        pixels = arguments[0].flatten(2)[0]
        pixels = pixels[:, :: -(-pixels.shape[1] // MAX_PIXELS)]
        few = int(OUTLIERS * pixels.shape[1]) + 1
        low, high = (pixels.topk(few, largest=up).values[:, -1] for up in (False, True))
        ends[name].append(torch.stack((low, high), dim=1).float().cpu().numpy())

    hooks = [
        layer.register_forward_pre_hook(partial(measure, name)) for name, layer in layers.items()
    ]
    device = next(module.parameters()).device
    try:
        for image in inputs:
            module(torch.from_numpy(image).to(device))
    finally:
        for hook in hooks:
            hook.remove()
    means = {name: np.mean(image_ends, axis=0) for name, image_ends in ends.items()}
    return {name: Int8Input.from_ranges(*mean.T) for name, mean in means.items()}
