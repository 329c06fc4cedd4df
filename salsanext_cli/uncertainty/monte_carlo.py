# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

import hashlib
from collections.abc import Iterable, Iterator, Sequence
from functools import partial

import numpy as np
import torch
from torch import Tensor

from salsanext_cli.compiled import argument, compiled, parallel_for_slices, thread_count
from salsanext_cli.engines.device import MAX_BATCH_PIXELS
from salsanext_cli.engines.network import Engine, Network
from salsanext_cli.engines.torch_engine import inference_mode
from salsanext_cli.errors import UsageError
from salsanext_cli.network.dropout import random_masks, require_dropout, sampling
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Double, Float, RangeImage
from salsanext_cli.uncertainty.estimate import Estimate, entropy

PASSES_PER_THREAD = 4  # Passes before results are added up, in order


class PassStatistics:
    """Running sums over passes, in float64 so that the variance does not cancel."""

    def __init__(self, shape: tuple[int, int, int]) -> None:
        self.count = 0
        self.sum, self.sum_of_squares = np.zeros(shape), np.zeros(shape)
        self.sum_of_entropies = np.zeros(shape[1:])

    def add(self, softmax: Float, nats: Float | float = 0.0) -> None:
        """Count one pass: its softmax (C, H, W) and the entropy of each pixel (H, W)."""
        self.count += 1
        values: Float = argument(softmax, np.float32).reshape(-1)
        total, squares = self.sum.reshape(-1), self.sum_of_squares.reshape(-1)
        parallel_for_slices(lambda s: _add_up(values[s], total[s], squares[s]), len(values))
        self.sum_of_entropies += nats

    def variance(self) -> Double:
        """Return the variance (C, H, W) of the population (paper III-C.2)."""
        mean = self.sum / self.count
        return np.maximum(self.sum_of_squares / self.count - mean * mean, 0)

    def summary(self) -> Estimate:
        """Return mean, variance and mutual information."""
        mean = self.sum / self.count
        information = entropy(mean) - self.sum_of_entropies / self.count
        return Estimate.of(mean, self.variance(), np.maximum(information, 0))


@compiled
def _add_up(values: Float, total: Double, squares: Double) -> None:
    for i in range(len(values)):
        value = np.float64(values[i])
        total[i] += value
        squares[i] += value * value


def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Estimate:
    """Run the network with dropout on and batch norm frozen, and sum up the passes.

    What lies before the first dropout is computed once. Several passes run side by side, and no bit
    depends on how many. The probabilities of merged classes are added in each pass, before variance
    and entropy are computed.

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
    shape = (network.space.class_count, image.height, image.width)
    statistics = PassStatistics(shape)
    seeds = [pass_seed(seed, number) for number in range(samples)]
    passes = openvino_passes if network.engine.library == "openvino" else torch_passes
    with inference_mode(network.device):
        for softmax, nats in passes(network.engine, network.input(image.channels), seeds):
            inside = (..., slice(image.height), slice(image.width))
            softmax, nats = softmax[inside], nats[inside]
            if network.merging is not None:
                softmax = network.merged(softmax)
                nats = entropy(softmax)
            statistics.add(softmax, nats)
        return statistics.summary()


def openvino_passes(
    engine: Engine, image: Float, seeds: Sequence[int]
) -> Iterator[tuple[Float, Float]]:
    """Yield softmax (C, H, W) and entropy (H, W) of every pass, with the padding."""
    threads = thread_count()
    features = engine.graph("trunk", SegmentationNetwork.padded_trunk)(image)

    def inputs() -> list[Tensor]:
        return _inputs_of_rest(engine.module, map(torch.from_numpy, features))

    rest = engine.graph("rest", _rest, inputs, streams=threads)
    rate = require_dropout(engine.module)
    size = PASSES_PER_THREAD * threads
    for start in range(0, len(seeds), size):
        calls = []
        for seed in seeds[start : start + size]:
            draw = random_masks([torch.Generator().manual_seed(seed)])
            factors = [draw(shape[1], rate).numpy() for shape in rest.shapes[len(features) :]]
            calls.append([*features, *factors])
        for softmax, nats in rest.each(calls):
            yield softmax[0], nats[0]


def _rest(module: SegmentationNetwork, *inputs: Tensor) -> tuple[Tensor, Tensor]:
    """Return softmax and entropy from features (B, C, H, W) and factors of channels (B, C)."""
    factors = (given for given in inputs if given.dim() == 2)
    with sampling(lambda *_: next(factors)):
        return _softmax_and_entropy(module.rest(*(f for f in inputs if f.dim() == 4)))


def _softmax_and_entropy(logits: Tensor) -> tuple[Tensor, Tensor]:
    softmax, logarithm = logits.softmax(dim=1), logits.log_softmax(dim=1)
    return softmax, -(softmax * logarithm).sum(dim=1)


def _inputs_of_rest(module: SegmentationNetwork, features: Iterable[Tensor]) -> list[Tensor]:
    """Return the features, and factors for each dropout in the order of computation."""
    factors: list[Tensor] = []

    def draw(channels: int, _: float) -> Tensor:
        factors.append(torch.ones(1, channels))
        return factors[-1]

    given = list(features)
    with inference_mode("cpu"), sampling(draw):
        module.rest(*given)
    return [*given, *factors]


def torch_passes(
    engine: Engine, image: Float, seeds: Sequence[int]
) -> Iterator[tuple[Float, Float]]:
    """Yield softmax (C, H, W) and entropy (H, W) of every pass, on a GPU several at once."""
    features = engine.torch_module.padded_trunk(engine.tensor(image))
    most = 1 if engine.device == "cpu" else MAX_BATCH_PIXELS // features[0].shape[-2:].numel()
    size = max(1, most)
    for start in range(0, len(seeds), size):
        batch = seeds[start : start + size]
        function = partial(torch_batch, engine.torch_module, features)
        yield from engine.in_batches(function, batch, size, "passes")


def torch_batch(
    module: SegmentationNetwork, features: Sequence[Tensor], seeds: Sequence[int]
) -> Iterator[tuple[Float, Float]]:
    """Yield softmax (C, H, W) and entropy (H, W) of passes computed together."""
    with sampling(random_masks([torch.Generator().manual_seed(seed) for seed in seeds])):
        logits = module.rest(*(f.expand(len(seeds), -1, -1, -1) for f in features))
    softmax, nats = _softmax_and_entropy(logits.float())
    return zip(softmax.cpu().numpy(), nats.cpu().numpy(), strict=True)


def require_sampling(network: Network, samples: int) -> None:
    """Raise what `sample` raises, before any scan is read."""
    require_samples(samples)
    require_dropout(network.module)


def require_samples(samples: int) -> None:
    """Raise `UsageError` for less than two passes."""
    if samples < 2:
        raise UsageError("--samples", str(samples), "at least 2: one pass has no variance")


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass; with the sum of its parts, neighbours would share passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, whatever the order in which scans are worked on."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
