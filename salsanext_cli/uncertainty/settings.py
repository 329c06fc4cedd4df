# SPDX-License-Identifier: MIT
"""Settings of uncertainty: which method estimates it, with which numbers."""

import logging
from dataclasses import dataclass, replace
from typing import Any

from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.knn import KnnParameters
from salsanext_cli.geometry.normalise import noise_of
from salsanext_cli.inference.network import Network
from salsanext_cli.records import RangeImage
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.files.json_files import RecordedSettings
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.dropout_propagation import propagate_dropout
from salsanext_cli.uncertainty.estimate import Estimate, require_dropout
from salsanext_cli.uncertainty.monte_carlo import require_samples, sample, scan_seed

EPISTEMIC_KINDS = ("epistemic", "entropy", "mutual_information")
ALEATORIC_KINDS = ("aleatoric", "total")
"""Kinds of uncertainty; the second ones need the sensor's noise."""
METHODS = ("sampling", "analytic")

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Estimator:
    """Method of estimating uncertainty, and its numbers.

    Attributes
    ----------
    method : {"sampling", "analytic"}
        Monte-Carlo dropout, or its variance carried through the network in one pass.
    samples : int
        Passes per scan, at least 2, if sampling; 30 is the paper's number.
    seed : int
        If sampling, a scan's masks depend on this, its sequence and its name only.
    aleatoric : bool
        The sensor's noise is carried through the network too.
    """

    method: str = "sampling"
    samples: int = 30
    seed: int = 0
    aleatoric: bool = True

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise UsageError("--method", self.method, " or ".join(METHODS))
        require_samples(self.samples)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of uncertainty that are estimated."""
        return (*EPISTEMIC_KINDS, *ALEATORIC_KINDS) if self.aleatoric else EPISTEMIC_KINDS

    def settings(self, sensor: Sensor) -> dict[str, Any]:
        """Return what the results depend on besides the network and what it sees."""
        passes = {"samples": self.samples, "seed": self.seed} if self.method == "sampling" else {}
        noise = {"noise": noise_of(sensor)} if self.aleatoric else {}
        return {"method": self.method, "aleatoric": self.aleatoric, **passes, **noise}

    def require(self, network: Network) -> None:
        """Raise what `estimate` raises, before any scan is read."""
        require_dropout(network)
        if self.aleatoric:
            noise_of(network.sensor)

    def estimate(self, network: Network, image: RangeImage, scan: ScanFile) -> Estimate:
        """Return the prediction for a scan and the uncertainty of its pixels."""
        if self.method == "sampling":
            seed = scan_seed(self.seed, scan.sequence, scan.stem)
            found = sample(network, image, samples=self.samples, seed=seed)
        else:
            found = propagate_dropout(network, image)
        if not self.aleatoric:
            return found
        noise = aleatoric(network, image).mean(axis=0)
        return replace(found, uncertainty=replace(found.uncertainty, aleatoric=noise))


def recorded_estimator(settings: RecordedSettings) -> Estimator:
    """Return the estimator that the record of a run of `uncertainty` names."""
    method = settings["method"]
    passes = ("samples", "seed") if method == "sampling" else ()
    numbers = {key: settings.integer(key) for key in passes}
    return Estimator(method, aleatoric=settings.flag("aleatoric"), **numbers)


def possible_estimator(colour: str, seen: Sensor) -> Estimator:
    """Leave out what needs a noise that the sensor does not know, unless it is asked for."""
    aleatoric = colour in ALEATORIC_KINDS or seen.knows_noise
    if not aleatoric:
        log.warning("sensor %s does not know its noise: epistemic uncertainty only", seen.name)
    return Estimator(aleatoric=aleatoric)


def recorded_knn(knn: RecordedSettings) -> KnnParameters:
    """Return the neighbours that the record of a run names."""
    return KnnParameters(
        k=knn.integer("k"),
        window=knn.integer("window"),
        sigma=knn.number("sigma"),
        cutoff=knn.number("cutoff"),
    )
