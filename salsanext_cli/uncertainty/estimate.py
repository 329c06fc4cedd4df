# SPDX-License-Identifier: MIT
"""Estimate of epistemic uncertainty, however it is made."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.errors import WeightsError
from salsanext_cli.inference.network import Network
from salsanext_cli.network.dropout import dropouts
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Float, Uncertainty


@dataclass(frozen=True, slots=True)
class Estimate:
    """Mean and spread of the softmax under dropout.

    Attributes
    ----------
    probabilities : (C, H, W) float32
        Mean softmax: the prediction.
    variance : (C, H, W) float32
        Variance of the softmax, of each class.
    uncertainty : Uncertainty of (H, W) float32
        Every pixel's, occupied or not.
    """

    probabilities: Float
    variance: Float
    uncertainty: Uncertainty

    @classmethod
    def of(cls, mean: Tensor, variance: Tensor, information: Tensor) -> Estimate:
        """Gather mean and variance (C, H, W) and mutual information (H, W), on any device."""
        return cls(
            probabilities=as_array(mean),
            variance=as_array(variance),
            uncertainty=Uncertainty(
                epistemic=as_array(variance.mean(dim=0)),
                entropy=as_array(entropy(mean)),
                mutual_information=as_array(information),
            ),
        )


def entropy(probabilities: Tensor) -> Tensor:
    """Return the entropy over the first dimension in nats, (C, …) to (…)."""
    nats: Tensor = torch.special.entr(probabilities).sum(dim=0)
    # A softmax rounded up to above 1 would have a negative one.
    return nats.clamp(min=0)


def as_array(values: Tensor) -> Float:
    """Return a tensor of any device and number type as a float32 array."""
    array: Float = values.float().cpu().numpy()
    return array


def require_dropout(network: Network) -> float:
    """Return the dropout rate; `WeightsError` for a network that drops nothing."""
    if not (layers := dropouts(network.module)):
        found = "a network without dropout"
        remedy = "`salsanext tune dropout` finds one"
        raise WeightsError("weights", found, "a dropout rate above 0", remedy)
    return layers[0].rate


def trunk_of(module: SegmentationNetwork, image: Tensor) -> tuple[Tensor, ...]:
    """Return what lies before the first dropout: features of an image (B, 5, H, W), padded."""
    return module.trunk(module.pad(image))
