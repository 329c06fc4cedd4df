# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from salsanext_cli.errors import UsageError, WeightsError
from salsanext_cli.network.dropout import dropouts, sampling
from salsanext_cli.network.inference import Network
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Float, RangeImage, Uncertainty

log = logging.getLogger(__name__)

AT_ONCE = {"cpu": 64 * 1024, "cuda": 16 * 64 * 2048}
"""Pixels of passes side by side: on a CPU more only leave its cache, a GPU has enough to do."""


@dataclass(frozen=True, slots=True)
class Sampled:
    """What the passes agree on and where they differ.

    Attributes
    ----------
    probabilities : (C, H, W) float32
        Mean softmax over the passes: the prediction.
    variance : (C, H, W) float32
        Variance of the softmax over the passes, of each class.
    uncertainty : Uncertainty of (H, W) float32
        Every pixel's, occupied or not.
    """

    probabilities: Float
    variance: Float
    uncertainty: Uncertainty


class Moments:
    """Running sums over passes, in float64 so that the variance does not cancel."""

    def __init__(self) -> None:
        self.count = 0
        self.sum = torch.zeros(())
        self.sum_of_squares = torch.zeros(())
        self.sum_of_entropies = torch.zeros(())

    def add(self, probabilities: Tensor) -> None:
        """Count one pass, (C, H, W)."""
        double = probabilities.double()
        if self.count == 0:
            self.sum = torch.zeros_like(double)
            self.sum_of_squares = torch.zeros_like(double)
            self.sum_of_entropies = torch.zeros_like(double[0])
        self.count += 1
        self.sum += double
        self.sum_of_squares.addcmul_(double, double)
        self.sum_of_entropies += entropy(double)

    def summary(self) -> Sampled:
        """Divide once: mean, variance (of the population, paper III-C.2) and information."""
        mean = self.sum / self.count
        variance = (self.sum_of_squares / self.count - mean.square()).clamp(min=0)
        total = entropy(mean)
        return Sampled(
            probabilities=as_array(mean),
            variance=as_array(variance),
            uncertainty=Uncertainty(
                epistemic=as_array(variance.mean(dim=0)),
                entropy=as_array(total),
                mutual_information=as_array(
                    (total - self.sum_of_entropies / self.count).clamp(min=0)
                ),
            ),
        )


def entropy(probabilities: Tensor) -> Tensor:
    """Return the entropy over the first dimension in nats, (C, …) to (…)."""
    nats: Tensor = torch.special.entr(probabilities).sum(dim=0)
    # A softmax rounded up to above 1 would have a negative one.
    return nats.clamp(min=0)


@torch.inference_mode()
def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Sampled:
    """Run the network with dropout on and batch norm frozen, and sum up the passes.

    What lies before the first dropout is computed once. Several passes run side by side; how many
    depends on the size of the image, and only what rounds depends on how many.

    Parameters
    ----------
    network : Network
        With at least one dropout of a rate above 0. Its temperature is left out: the paper's
        variance is that of the plain softmax, and ranks errors better.
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
    moments = Moments()
    features = network.module.trunk(network.module.pad(network.input(image.channels)))
    seeds = [pass_seed(seed, number) for number in range(samples)]
    for logits in _passes(network.module, features, seeds):
        logits = logits[:, : image.height, : image.width].float()
        moments.add(torch.softmax(logits, dim=0))
    return moments.summary()


def _passes(
    module: SegmentationNetwork, features: tuple[Tensor, ...], seeds: Sequence[int]
) -> Iterator[Tensor]:
    """Yield the logits (C, H, W) of every pass, computing several at once if there is room."""
    size = _most_at_once(features[0], len(seeds))
    start = 0
    while start < len(seeds):
        batch = seeds[start : start + size]
        try:
            logits = _run(module, features, batch)
        except torch.OutOfMemoryError:
            if size == 1:
                raise
            size //= 2
            log.info("memory for %d passes at once is not there, trying %d", 2 * size, size)
            continue
        yield from logits
        start += len(batch)


def _most_at_once(features: Tensor, samples: int) -> int:
    """Return how many passes to try side by side."""
    pixels = features.shape[-2:].numel()
    return max(1, min(samples, AT_ONCE[features.device.type] // pixels))


def _run(module: SegmentationNetwork, features: tuple[Tensor, ...], seeds: Sequence[int]) -> Tensor:
    generators = [torch.Generator().manual_seed(seed) for seed in seeds]
    with sampling(module, generators):
        logits: Tensor = module.rest(*(f.expand(len(seeds), -1, -1, -1) for f in features))
    return logits


def require_sampling(network: Network, samples: int) -> None:
    """Raise what `sample` raises, before any scan is read."""
    require_samples(samples)
    require_dropout(network)


def require_samples(samples: int) -> None:
    """Raise `UsageError` for less than two passes."""
    if samples < 2:
        raise UsageError("--samples", str(samples), "at least 2: one pass has no variance")


def require_dropout(network: Network) -> None:
    """Raise `WeightsError` if a network drops nothing, and so knows no epistemic uncertainty."""
    if not dropouts(network.module):
        found = "a network without dropout"
        remedy = "`salsanext tune dropout` finds one"
        raise WeightsError("weights", found, "a dropout rate above 0", remedy)


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass: the sum of its parts would make neighbours share passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, whatever the order in which scans are worked on."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1


def as_array(values: Tensor) -> Float:
    """Return a tensor of any device and number type as a float32 array."""
    array: Float = values.float().cpu().numpy()
    return array
