# SPDX-License-Identifier: MIT
"""Epistemic uncertainty by Monte-Carlo dropout (paper III-C.2)."""

import hashlib
from dataclasses import dataclass

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.network.dropout import require_dropout
from salsanext_cli.core.records import Float, RangeImage
from salsanext_cli.core.wording import argument


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Uncertainty of the pixels of one scan, (H, W) float32.

    Attributes
    ----------
    epistemic
        Variance of the softmax over passes, mean over classes (paper III-C.2); 0…(1 - 1/C)/C.
    entropy
        Entropy of the mean softmax in nats; 0…ln C.
    mutual_information
        `entropy` minus the mean entropy of the passes in nats; 0…ln C.
    aleatoric, optional
        Variance of the softmax by the noise of the sensor, mean over classes; 0…(1 - 1/C)/C. It
        ranks points; its scale is far too small.
    """

    epistemic: Float
    entropy: Float
    mutual_information: Float
    aleatoric: Float | None = None

    @property
    def total(self) -> Float | None:
        """Epistemic plus aleatoric uncertainty, if both are estimated (paper III-C)."""
        return None if self.aleatoric is None else self.epistemic + self.aleatoric


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """Mean and variance of the softmax under dropout, (C, H, W) float32, and the uncertainty.

    The mean softmax `probabilities` is the prediction. Empty pixels have values too.
    """

    probabilities: Float
    variance: Float
    uncertainty: Uncertainty


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
    spread = network.backend.sample(network.input(image.channels), seeds, network.merging)
    uncertainty = Uncertainty(
        epistemic=spread.epistemic,
        entropy=spread.entropy,
        mutual_information=spread.mutual_information,
    )
    return Estimate(probabilities=spread.mean, variance=spread.variance, uncertainty=uncertainty)


def require_sampling(network: Network, samples: int) -> None:
    """Raise the errors of `sample`, before any scan is read."""
    require_samples(samples)
    require_dropout(network.module)


def require_samples(samples: int) -> None:
    """Raise `UsageError` for fewer than two passes."""
    if samples < 2:
        raise UsageError(argument("samples"), str(samples), "at least 2: one pass has no variance")


def pass_seed(seed: int, number: int) -> int:
    """Return the seed of one pass; a sum would give neighbouring seeds the same passes."""
    return _hashed(f"{seed}/{number}")


def scan_seed(seed: int, sequence: str, stem: str) -> int:
    """Return the seed of one scan, which does not depend on the order of scans."""
    return _hashed(f"{seed}/{sequence}/{stem}")


def _hashed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "little") >> 1
