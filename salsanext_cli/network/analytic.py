# SPDX-License-Identifier: MIT
"""Epistemic uncertainty in one pass: the variance of dropout carried through the network."""

from __future__ import annotations

import torch

from salsanext_cli.network.adf import propagate
from salsanext_cli.network.coherent import Coherent
from salsanext_cli.network.estimate import Estimate, entropy, require_dropout
from salsanext_cli.network.inference import Network
from salsanext_cli.network.parts import on_duty
from salsanext_cli.records import RangeImage

TINY = 1e-12


def analyse(network: Network, image: RangeImage) -> Estimate:
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
    with network.computing(), on_duty():
        certain = network.engine.trunk(network.engine.pad(network.input(image.channels)))
        features = (Coherent(f, torch.zeros_like(f)) for f in map(torch.Tensor.float, certain))
        logits = propagate(network.module.rest, *features)[..., : image.height, : image.width]
        softmax = logits.softmax(dim=1)
        mean, variance = softmax.mean[0].double(), softmax.variance[0].double()
        information = (variance / (2 * mean).clamp(min=TINY)).sum(dim=0)
        return Estimate.of(mean, variance, information.minimum(entropy(mean)))
