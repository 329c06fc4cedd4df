# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

import hashlib
from collections.abc import Sequence
from functools import partial

import torch
from torch import Tensor

from salsanext_cli.errors import UsageError
from salsanext_cli.inference.network import Network
from salsanext_cli.inference.parallel_for import parallel_for, single_threaded_torch
from salsanext_cli.network.dropout import sampling
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.estimate import Estimate, entropy, require_dropout

MAX_BATCH_PIXELS = 16 * 64 * 2048
"""Pixels of the passes that a GPU computes side by side."""
MAX_KEPT_PASSES = 32
"""Passes of which the softmax is kept until it is added up."""
BANDS = 8
"""Parts of an image that are added up side by side."""


class PassStatistics:
    """Running sums over passes, in float64 so that the variance does not cancel."""

    def __init__(self) -> None:
        self.count = 0
        self.sum = torch.zeros(())
        self.sum_of_squares = torch.zeros(())
        self.sum_of_entropies = torch.zeros(())

    def add(self, passes: Sequence[Tensor]) -> None:
        """Count passes, each the softmax (C, H, W)."""
        if self.count == 0:
            self.sum = torch.zeros_like(passes[0], dtype=torch.float64)
            self.sum_of_squares = torch.zeros_like(self.sum)
            self.sum_of_entropies = torch.zeros_like(self.sum[0])
        self.count += len(passes)
        width, bands = self.sum.shape[-1], BANDS if self.sum.device.type == "cpu" else 1

        def add_up(part: int) -> None:
            band = slice(width * part // bands, width * (part + 1) // bands)
            for probabilities in passes:
                double = probabilities[..., band].double()
                self.sum[..., band] += double
                self.sum_of_squares[..., band].addcmul_(double, double)
                self.sum_of_entropies[..., band] += entropy(double)

        parallel_for(add_up, bands)

    def summary(self) -> Estimate:
        """Divide once: mean, variance (of the population, paper III-C.2) and information."""
        mean = self.sum / self.count
        variance = (self.sum_of_squares / self.count - mean.square()).clamp(min=0)
        information = entropy(mean) - self.sum_of_entropies / self.count
        return Estimate.of(mean, variance, information.clamp(min=0))


def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Estimate:
    """Run the network with dropout on and batch norm frozen, and sum up the passes.

    What lies before the first dropout is computed once. Several passes run side by side: on a CPU
    one on each thread, so that no bit depends on how many, on a GPU in batches.

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
    statistics, engine = PassStatistics(), network.engine
    seeds = [pass_seed(seed, number) for number in range(samples)]
    passes = on_threads if network.device.type == "cpu" else on_gpu
    # In a pass torch has one thread, whether the engine shares its work or not.
    with network.inference_mode(), single_threaded_torch():
        features = engine.trunk(engine.pad(network.input(image.channels)))
        for start in range(0, samples, MAX_KEPT_PASSES):
            kept = passes(network, features, seeds[start : start + MAX_KEPT_PASSES])
            statistics.add([softmax[:, : image.height, : image.width] for softmax in kept])
        return statistics.summary()


def on_threads(
    network: Network, features: tuple[Tensor, ...], seeds: Sequence[int]
) -> list[Tensor]:
    """Return the softmax (C, H, W) of every pass, each computed by one thread."""
    found = [features[0]] * len(seeds)

    def run(number: int) -> None:
        (found[number],) = one_batch(network.engine, features, seeds[number : number + 1])

    parallel_for(run, len(seeds))
    return found


def on_gpu(network: Network, features: tuple[Tensor, ...], seeds: Sequence[int]) -> list[Tensor]:
    """Return the softmax (C, H, W) of every pass, as many together as there is room for."""
    most = max(1, MAX_BATCH_PIXELS // features[0].shape[-2:].numel())
    return network.in_batches(partial(one_batch, network.engine, features), seeds, most, "passes")


def one_batch(
    module: SegmentationNetwork, features: tuple[Tensor, ...], seeds: Sequence[int]
) -> Tensor:
    """Return the softmax (B, C, H, W) of passes computed together."""
    with sampling([torch.Generator().manual_seed(seed) for seed in seeds]):
        logits = module.rest(*(f.expand(len(seeds), -1, -1, -1) for f in features))
    return torch.softmax(logits.float(), dim=1)


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
