# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterator, Sequence

import torch
from torch import Tensor

from salsanext_cli.errors import UsageError
from salsanext_cli.network.crew import on_duty
from salsanext_cli.network.dropout import sampling
from salsanext_cli.network.estimate import Estimate, entropy, require_dropout
from salsanext_cli.network.inference import Network
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import RangeImage

log = logging.getLogger(__name__)

AT_ONCE = {"cpu": 64 * 1024, "cuda": 16 * 64 * 2048}
"""Pixels of passes side by side: on a CPU more only leave its cache, a GPU has enough to do."""


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

    def summary(self) -> Estimate:
        """Divide once: mean, variance (of the population, paper III-C.2) and information."""
        mean = self.sum / self.count
        variance = (self.sum_of_squares / self.count - mean.square()).clamp(min=0)
        information = entropy(mean) - self.sum_of_entropies / self.count
        return Estimate.of(mean, variance, information.clamp(min=0))


@on_duty()
@torch.inference_mode()
def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Estimate:
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
    features = network.engine.trunk(network.engine.pad(network.input(image.channels)))
    seeds = [pass_seed(seed, number) for number in range(samples)]
    for logits in _passes(network.engine, features, seeds):
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


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass: the sum of its parts would make neighbours share passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, whatever the order in which scans are worked on."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
