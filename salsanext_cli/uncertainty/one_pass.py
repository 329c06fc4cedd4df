# SPDX-License-Identifier: MIT
"""Epistemic uncertainty in one pass: the variance of dropout carried through the network."""

from __future__ import annotations

import torch

from salsanext_cli.inference.network import Network
from salsanext_cli.inference.parallel_for import single_threaded_torch
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.adf import propagate
from salsanext_cli.uncertainty.dropout_propagation import ChannelCorrelatedGaussian
from salsanext_cli.uncertainty.estimate import Estimate, entropy, require_dropout

TINY = 1e-12


def propagate_dropout(network: Network, image: RangeImage) -> Estimate:
    """Estimate what `sample` would tend to with ever more passes.

    The mutual information is that of a small spread of the softmax around its mean, ½ Σ v / p, and
    at most the entropy.

    Parameters
    ----------
    network : Network
        With at least one dropout of a rate above 0; its temperature is left out, as in `sample`.
    image : RangeImage
        One scan.

    Raises
    ------
    WeightsError
        If the network drops nothing.
    """
    require_dropout(network)
    with network.computing(), single_threaded_torch():
        certain = network.engine.trunk(network.engine.pad(network.input(image.channels)))
        features = (
            ChannelCorrelatedGaussian(f, torch.zeros_like(f))
            for f in map(torch.Tensor.float, certain)
        )
        logits = propagate(network.module.rest, *features)[..., : image.height, : image.width]
        softmax = logits.softmax(dim=1)
        mean, variance = softmax.mean[0].double(), softmax.variance[0].double()
        information = (variance / (2 * mean).clamp(min=TINY)).sum(dim=0)
        return Estimate.of(mean, variance, information.minimum(entropy(mean)))
