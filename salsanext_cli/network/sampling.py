# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.network.dropout import dropouts, sampling
from salsanext_cli.network.inference import Network
from salsanext_cli.network.salsanext import pad
from salsanext_cli.records import Float, RangeImage, Uncertainty

TINY = 1e-12


@dataclass(frozen=True, slots=True)
class Sampled:
    """What the passes agree on and where they differ.

    Attributes
    ----------
    probabilities : (C, H, W) float32
        Mean softmax over the passes: the prediction.
    uncertainty : Uncertainty of (H, W) float32
        Every pixel's, occupied or not.
    """

    probabilities: Float
    uncertainty: Uncertainty


class Moments:
    """Running sums over passes, in float64 so that the variance does not cancel."""

    def __init__(self) -> None:
        self.count = 0
        self.sum: Tensor | float = 0.0
        self.sum_of_squares: Tensor | float = 0.0
        self.sum_of_entropies: Tensor | float = 0.0

    def add(self, probabilities: Tensor) -> None:
        """Count one pass, (C, H, W)."""
        double = probabilities.double()
        self.count += 1
        self.sum = self.sum + double
        self.sum_of_squares = self.sum_of_squares + double.square()
        self.sum_of_entropies = self.sum_of_entropies + entropy(double)

    def summary(self) -> Sampled:
        """Divide once: mean, variance (of the population, paper III-C.2) and information."""
        mean = torch.as_tensor(self.sum) / self.count
        variance = (torch.as_tensor(self.sum_of_squares) / self.count - mean.square()).clamp(min=0)
        total = entropy(mean)
        expected = torch.as_tensor(self.sum_of_entropies) / self.count
        return Sampled(
            probabilities=_array(mean),
            uncertainty=Uncertainty(
                epistemic=_array(variance.mean(dim=0)),
                entropy=_array(total),
                mutual_information=_array((total - expected).clamp(min=0)),
            ),
        )


def entropy(probabilities: Tensor) -> Tensor:
    """Return the entropy over the first dimension in nats, (C, …) to (…)."""
    # A softmax rounded up to above 1 would have a negative one.
    return -(probabilities * probabilities.clamp(TINY, 1).log()).sum(dim=0)


@torch.inference_mode()
def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Sampled:
    """Run the network with dropout on and batch norm frozen, and sum up the passes.

    What lies before the first dropout is computed once.

    Parameters
    ----------
    network : Network
        With at least one dropout of a rate above 0.
    image : RangeImage
        One scan.
    samples : int
        Number of passes, at least 2.
    seed : int
        Pass i draws its masks from a generator seeded with `pass_seed(seed, i)`.

    Raises
    ------
    UsageError
        If `samples` is below 2: one pass has no variance.
    WeightsError
        If the network has no dropout to sample.
    """
    require_sampling(network, samples)
    module = network.module
    moments = Moments()
    features = module.trunk(pad(network.input(image.channels)))
    for number in range(samples):
        generator = torch.Generator().manual_seed(pass_seed(seed, number))
        with sampling(module, [generator]):
            logits = module.rest(*features)[0, :, : image.height, : image.width]
        moments.add(torch.softmax(logits.float(), dim=0))
    return moments.summary()


def require_sampling(network: Network, samples: int) -> None:
    """Raise what `sample` raises, before any scan is read."""
    if samples < 2:
        raise UsageError("--samples", str(samples), "at least 2: one pass has no variance")
    if not dropouts(network.module):
        found = "a network without dropout"
        raise WeightsError("weights", found, "a dropout rate above 0", "train with dropout")


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass: the sum of its parts would make neighbours share passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, whatever the order in which scans are worked on."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1


def _array(values: Tensor) -> Float:
    array: Float = values.float().cpu().numpy()
    return array
