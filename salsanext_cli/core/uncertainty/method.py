# SPDX-License-Identifier: MIT
"""Method of estimating uncertainty."""

from dataclasses import dataclass, replace

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.network.dropout import require_dropout
from salsanext_cli.core.records import RangeImage
from salsanext_cli.core.uncertainty.aleatoric import COPIES, aleatoric, noise_variance
from salsanext_cli.core.uncertainty.monte_carlo import Estimate, require_samples, sample
from salsanext_cli.core.wording import argument, setting

EPISTEMIC_KINDS = ("epistemic", "entropy", "mutual_information")
ALEATORIC_KINDS = ("aleatoric", "total")  # These need the sensor's noise
ALEATORIC_METHODS = ("copies", "paper", "none")


@dataclass(frozen=True, slots=True)
class UncertaintyMethod:
    """Method of estimating uncertainty.

    Attributes
    ----------
    samples : int
        Passes of Monte-Carlo dropout per scan, at least 2; default: the paper's number.
    seed : int
        Masks and noise of a scan depend only on this seed and on sequence and name of the scan.
    aleatoric : {"copies", "paper", "none"}
        Effect of the sensor's noise: by passes over noisy copies of the scan, by assumed density
        filtering, or not estimated.
    """

    samples: int = 30
    seed: int = 0
    aleatoric: str = "copies"

    def __post_init__(self) -> None:
        if self.aleatoric not in ALEATORIC_METHODS:
            methods = " or ".join(ALEATORIC_METHODS)
            raise UsageError(argument("aleatoric"), self.aleatoric, methods)
        require_samples(self.samples)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of uncertainty that `estimate` returns."""
        return (*EPISTEMIC_KINDS, *ALEATORIC_KINDS) if self.is_noisy else EPISTEMIC_KINDS

    @property
    def is_noisy(self) -> bool:
        """Whether the noise of the sensor is needed."""
        return self.aleatoric != "none"

    @property
    def passes_text(self) -> str:
        """Passes of the network for each scan, in words."""
        passes = f"{self.samples} passes with dropout"
        if self.aleatoric == "copies":
            return f"{passes} and {COPIES} of noisy copies"
        return f"{passes} and one that propagates the noise" if self.is_noisy else passes

    def require(self, network: Network) -> None:
        """Raise the errors of `estimate`, before any scan is read."""
        require_dropout(network.module)
        if self.is_noisy:
            network.sensor.require_noise()
        if self.aleatoric == "paper" and network.merging is not None:
            problem = "paper does not cover merged classes"
            hint = f"use {setting('aleatoric', 'copies')}"
            raise UsageError(argument("aleatoric"), problem, "the classes of the weights", hint)

    def estimate(self, network: Network, image: RangeImage, seed: int) -> Estimate:
        """Return the prediction for a scan and the uncertainty of its pixels.

        Parameters
        ----------
        network : Network
            Network for the sensor of the scan.
        image : RangeImage
            H × W pixels.
        seed : int
            Seed of the masks and the noise, as of `scan_seed`.

        Returns
        -------
        Estimate
        """
        estimate = sample(network, image, samples=self.samples, seed=seed)
        if not self.is_noisy:
            return estimate
        by_copies = self.aleatoric == "copies"
        noise = noise_variance(network, image, seed) if by_copies else aleatoric(network, image)
        uncertainty = replace(estimate.uncertainty, aleatoric=noise.mean(axis=0))
        return replace(estimate, uncertainty=uncertainty)
