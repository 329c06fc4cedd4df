# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

import hashlib

import numpy as np

from salsanext_cli.engines.moments import entropy
from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError
from salsanext_cli.network.dropout import require_dropout
from salsanext_cli.records import RangeImage
from salsanext_cli.uncertainty.estimate import Estimate, Uncertainty


def sample(network: Network, image: RangeImage, *, samples: int, seed: int) -> Estimate:
    """Estimate by passes of the network with dropout on and batch norm frozen.

    The layers before the first dropout are computed once. Several passes run in parallel, without
    influence on any bit. The probabilities of merged classes are added in each pass.

    Parameters
    ----------
    network : Network
        With a dropout rate above 0. Its temperature is ignored: the paper takes the variance of the
        plain softmax, which ranks errors better.
    image : RangeImage
        One scan.
    samples : int
        Number of passes, at least 2.
    seed : int
        Pass i draws its masks from a generator seeded with `pass_seed(seed, i)`.

    Returns
    -------
    Estimate

    Raises
    ------
    UsageError
        If `samples` is below 2.
    WeightsError
        If the network has no dropout.
    """
    require_sampling(network, samples)
    seeds = [pass_seed(seed, number) for number in range(samples)]
    moments = network.backend.sample(network.input(image.channels), seeds, network.merging)
    mean, variance = moments.mean(), moments.variance()
    total = entropy(mean)
    information = np.maximum(total - moments.sum_of_entropies / moments.count, 0)
    uncertainty = Uncertainty(
        epistemic=variance.mean(axis=0).astype(np.float32),
        entropy=total.astype(np.float32),
        mutual_information=information.astype(np.float32),
    )
    return Estimate(mean.astype(np.float32), variance.astype(np.float32), uncertainty)


def require_sampling(network: Network, samples: int) -> None:
    """Raise the errors of `sample`, before any scan is read."""
    require_samples(samples)
    require_dropout(network.module)


def require_samples(samples: int) -> None:
    """Raise `UsageError` for fewer than two passes."""
    if samples < 2:
        raise UsageError("--samples", str(samples), "at least 2: one pass has no variance")


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass; a sum would give neighbouring seeds the same passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, which does not depend on the order of scans."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
