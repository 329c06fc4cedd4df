# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

import hashlib

import numpy as np

from salsanext_cli.engines.moments import entropy
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError
from salsanext_cli.network.dropout import require_dropout
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.estimate import Estimate


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
    seeds = [pass_seed(seed, number) for number in range(samples)]
    given = network.input(image.channels)
    moments = network.backend.sample(given, seeds, network.merging)
    mean = moments.mean()
    total = entropy(mean)
    information = np.maximum(total - moments.sum_of_entropies / moments.count, 0)
    return Estimate.of(mean, moments.variance(), total, information)


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
