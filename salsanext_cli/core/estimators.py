# SPDX-License-Identifier: MIT
"""Uncertainty of scans: by the CPU kernels, or on the device of a network in torch.

This is the only place that chooses between both. An estimator works in three steps, which the job
of `uncertainty` takes on different threads.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labellers import computes_on_gpu
from salsanext_cli.core.labelling import (
    EstimatedScan,
    PreparedScan,
    prepare_for,
    project_scan,
    refine_labels,
)
from salsanext_cli.core.records import Float, Origin, Scan
from salsanext_cli.core.uncertainty.error_features import error_probability
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.monte_carlo import Estimate


class Estimator(Protocol):
    """Way of scans to their uncertainty."""

    def prepare(
        self, scan: Scan, seed: int, origin: Origin | None = None, source: object = "scan"
    ) -> Any:
        """Check a scan and make it ready for the device, on any thread.

        Parameters
        ----------
        scan : Scan
            N points, in the frame of their file.
        seed : int
            Seed of the masks and the noise, as of `scan_seed`.
        origin : tuple of float, optional
            Position of the sensor of a registered scan, in metres; by default found from its
            points.
        source : object
            Name of the scan in errors.

        Returns
        -------
        object
            Scan for `compute`.

        Raises
        ------
        FormatError
            If the points are not those of a scan in metres around a sensor.
        """

    def compute(self, scans: Sequence[Any]) -> Sequence[Any]:
        """Compute what `finish` needs of scans that `prepare` made ready.

        A GPU may still compute when it returns; `finish` waits for it.
        """

    def finish(self, scan: Any, computed: Any) -> EstimatedScan:
        """Return the uncertainty of a scan, on any thread.

        Raises
        ------
        WeightsError
            If a result is not finite; `compute` may raise it too.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SeededScan:
    """Scan that is ready for a network, and the seed of its masks and noise."""

    prepared: PreparedScan
    seed: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelUncertainty:
    """Uncertainty of the pixels of a scan."""

    estimate: Estimate  # From several passes
    softmax: Float | None  # (C, H, W) of one pass, if the error model needs it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KernelEstimator:
    """Estimates by any backend, one scan after the other, and projects by the CPU kernels.

    Attributes
    ----------
    network : Network
        Network for the sensors of the scans.
    request : EstimateRequest
        Results of each scan.
    """

    network: Network
    request: EstimateRequest

    def prepare(
        self, scan: Scan, seed: int, origin: Origin | None = None, source: object = "scan"
    ) -> SeededScan:
        """Check and project a scan, and make the input of the network."""
        network = self.network
        projected = project_scan(scan, network.sensor, network.card.sensor, origin, source)
        return SeededScan(prepared=prepare_for(network, projected), seed=seed)

    def compute(self, scans: Sequence[SeededScan]) -> list[PixelUncertainty]:
        """Estimate the uncertainty of the pixels of scans."""
        return [self._estimated(scan) for scan in scans]

    def _estimated(self, scan: SeededScan) -> PixelUncertainty:
        network = scan.prepared.network
        projected = scan.prepared.projected
        estimate = self.request.method.estimate(network, projected.image, scan.seed)
        network.backend.require_finite(estimate.probabilities, projected.source)
        softmax = None
        if self.request.error:
            (pixels,) = network.predict([scan.prepared.input], softmax=True)
            network.backend.require_finite(pixels.confidence, projected.source)
            softmax = pixels.softmax
        return PixelUncertainty(estimate=estimate, softmax=softmax)

    def finish(self, scan: SeededScan, computed: PixelUncertainty) -> EstimatedScan:
        """Return the uncertainty of the points, and their labels if requested."""
        projected = scan.prepared.projected
        image = projected.image
        uncertainty = {}
        for kind in self.request.method.kinds:
            pixel_values = getattr(computed.estimate.uncertainty, kind)
            uncertainty[kind] = points_from_pixels(pixel_values, image.pixel_of_point, np.nan)
        if not self.request.labels:
            return EstimatedScan(checked=projected, uncertainty=uncertainty)
        mean = PixelPrediction.from_softmax(computed.estimate.probabilities)
        labels = refine_labels(scan.prepared, mean, self.request.knn).labels
        error = None
        if computed.softmax is not None:
            network = scan.prepared.network
            error = error_probability(network, image, computed.softmax, labels)
        return EstimatedScan(checked=projected, uncertainty=uncertainty, labels=labels, error=error)


def estimator_for(network: Network, request: EstimateRequest) -> Estimator:
    """Return what estimates with a network: the GPU that computes it, else the kernels."""
    if not computes_on_gpu(network):
        return KernelEstimator(network=network, request=request)
    # Only here, because other engines need no torch.
    from salsanext_cli.core.on_device.estimator import DeviceEstimator

    return DeviceEstimator(network=network, request=request)
