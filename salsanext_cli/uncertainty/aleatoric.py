# SPDX-License-Identifier: MIT
"""Aleatoric uncertainty: the sensor's noise carried through the network (paper III-C.1)."""

import torch

from salsanext_cli.geometry.normalise import input_variance
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.parallel_for import single_threaded_torch
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.uncertainty.adf import Gaussian, propagate
from salsanext_cli.uncertainty.estimate import as_array


def aleatoric(network: Network, image: RangeImage) -> Float:
    """Return the variance of every pixel's softmax that comes from noise of the input.

    One pass of assumed density filtering, dropout off, without the temperature, as in `sample`.

    Parameters
    ----------
    network : Network
        Whose sensor knows its noise.
    image : RangeImage
        One scan.

    Returns
    -------
    (C, H, W) float32
        At least 0; its mean over the classes is the aleatoric uncertainty.

    Raises
    ------
    UsageError
        If the sensor does not know its noise.
    """
    with network.inference_mode(), single_threaded_torch():
        mean = network.input(image.channels)
        variance = torch.from_numpy(input_variance(image.channels, network.sensor))[None].to(mean)
        variance = variance.contiguous(memory_format=torch.channels_last)
        logits = propagate(network.module, Gaussian(mean, variance))
        return as_array(logits.softmax(dim=1).variance[0])
