# SPDX-License-Identifier: MIT
"""Methods of estimating uncertainty, and their numbers."""

from dataclasses import dataclass, replace

from salsanext_cli.engines.network import Network
from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.network_input import noise_of
from salsanext_cli.network.dropout import require_dropout
from salsanext_cli.records import RangeImage
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.uncertainty.estimate import Estimate
from salsanext_cli.uncertainty.monte_carlo import require_samples, sample, scan_seed

EPISTEMIC_KINDS = ("epistemic", "entropy", "mutual_information")
ALEATORIC_KINDS = ("aleatoric", "total")  # These need the sensor's noise
ALEATORIC_METHODS = ("copies", "paper", "none")


@dataclass(frozen=True, slots=True)
class UncertaintyMethod:
    """Way of estimating uncertainty, and its numbers."""

    samples: int = 30  # Passes of Monte-Carlo dropout per scan, at least 2; the paper's number
    seed: int = 0  # A scan's masks and noise depend on this, its sequence and its name only
    # {"copies", "paper", "none"}: the sensor's noise: by passes over noisy copies of the scan, or
    # carried through the network by assumed density filtering; or no aleatoric uncertainty
    aleatoric: str = "copies"

    def __post_init__(self) -> None:
        if self.aleatoric not in ALEATORIC_METHODS:
            raise UsageError("--aleatoric", str(self.aleatoric), ", ".join(ALEATORIC_METHODS))
        require_samples(self.samples)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of uncertainty that are estimated."""
        return (*EPISTEMIC_KINDS, *ALEATORIC_KINDS) if self.is_noisy else EPISTEMIC_KINDS

    @property
    def is_noisy(self) -> bool:
        """True if the noise of the sensor counts."""
        return self.aleatoric != "none"

    def require(self, network: Network) -> None:
        """Raise what `estimate` raises, before any scan is read."""
        require_dropout(network.module)
        if self.is_noisy:
            noise_of(network.sensor)

    def estimate(self, network: Network, image: RangeImage, scan: ScanFile) -> Estimate:
        """Return the prediction for a scan and the uncertainty of its pixels."""
        seed = scan_seed(self.seed, scan.sequence, scan.stem)
        estimate = sample(network, image, samples=self.samples, seed=seed)
        if not self.is_noisy:
            return estimate
        of_copies = self.aleatoric == "copies"
        noise = noise_variance(network, image, seed) if of_copies else aleatoric(network, image)
        own = replace(estimate.uncertainty, aleatoric=noise.mean(axis=0))
        return replace(estimate, uncertainty=own)
