# SPDX-License-Identifier: MIT
"""Aleatoric uncertainty: the sensor's noise carried through the network (paper III-C.1)."""

import torch
from torch import Tensor

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.torch_engine import inference_mode
from salsanext_cli.geometry.normalise import input_variance
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.uncertainty.adf import Gaussian, propagate


def aleatoric(network: Network, image: RangeImage) -> Float:
    """Return the variance of every pixel's softmax that comes from noise of the input.

    One pass of assumed density filtering, dropout off, without the temperature, as in `sample`.

    `network`: whose sensor knows its noise; `image`: one scan.

    Returns (C, H, W) float32, at least 0; its mean over the classes is the aleatoric uncertainty.
    """
    engine, mean = network.engine, network.fit.input(image.channels)
    variance = input_variance(network.fit.filled(image.channels), network.sensor)[None]
    with inference_mode(engine.device):
        if engine.library == "openvino":
            inputs = [engine.example_input()] * 2
            graph = engine.graph("moments", _moments, lambda: inputs, precision="float32")
            moments = tuple(map(torch.from_numpy, graph(mean, variance)))
        else:
            given = (torch.from_numpy(values).to(engine.device) for values in (mean, variance))
            moments = _moments(engine.module, *given)
        softmax = Gaussian(*moments).softmax(dim=1, groups=network.groups)
        variances: Float = softmax.variance[0].cpu().numpy()
        return variances


def _moments(module: SegmentationNetwork, mean: Tensor, variance: Tensor) -> tuple[Tensor, Tensor]:
    """Return mean and variance of the logits from those of the input, (B, 5, H, W)."""
    logits = propagate(module, Gaussian(mean, variance))
    return logits.mean, logits.variance
