# SPDX-License-Identifier: MIT
"""Scan as the network sees it: described by features and uncertainty, or labelled."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from torch import Tensor

from salsanext_cli.engines.network import Network
from salsanext_cli.errors import FormatError
from salsanext_cli.fitting.label_scan import PreparedScan, ProjectedScan, prepared_for
from salsanext_cli.fitting.scan_checks import ScanCheck
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.records import Double, Float
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.uncertainty.estimate import Estimate
from salsanext_cli.uncertainty.monte_carlo import sample


@dataclass(frozen=True, slots=True, eq=False)
class ScanDescription:
    """Means over the pixels of a scan that hold a point."""

    file: ScanFile
    # (D,) float64: of the layer before the logits, without dropout; 32 in SalsaNext
    features: Double
    uncertainty: float  # Mutual information of label and weights, nats
    check: ScanCheck  # Reasons to doubt the scan


@dataclass(frozen=True, slots=True)
class DescribeJob:
    """Job that describes scans by what a network makes of them."""

    network: Network
    samples: int  # Passes of dropout
    seed: int

    def prepare(self, file: ScanFile) -> PreparedScan:
        """Read, check and project a scan."""
        scan = prepared_for(self.network, file)
        if not (scan.projected.image.point_of_pixel >= 0).any():
            raise FormatError(file.path, "no point is in view of the sensor", "a scan with points")
        return scan

    def compute(self, scans: Sequence[PreparedScan]) -> list[tuple[Float, Float]]:
        """Return features (D, H, W) and mutual information (H, W) of each scan."""
        return [self._compute(*scan) for scan in scans]

    def _compute(
        self, projected: ProjectedScan, network: Network, given: Float
    ) -> tuple[Float, Float]:
        features = pixel_features(network, given)
        # The masks of dropout are the same for every scan: between masks the mutual information
        # varies more than between scans of one drive.
        estimate = checked_sample(projected, network, self.samples, self.seed)
        return features, estimate.uncertainty.mutual_information

    def finish(self, scan: PreparedScan, computed: tuple[Float, Float]) -> ScanDescription:
        """Return the means over the pixels with a point."""
        (projected, network, _), (of_pixels, information) = scan, computed
        filled = projected.image.point_of_pixel >= 0
        features = of_pixels[:, filled].mean(axis=1, dtype=np.float64)
        network.backend.require_finite(features, projected.file.path)
        mean = float(information[filled].mean(dtype=np.float64))
        return ScanDescription(projected.file, features, mean, projected.check)


def checked_sample(projected: ProjectedScan, network: Network, samples: int, seed: int) -> Estimate:
    """Estimate by Monte-Carlo dropout; `WeightsError` if the result is not finite."""
    estimate = sample(network, projected.image, samples=samples, seed=seed)
    network.backend.require_finite(estimate.probabilities, projected.file.path)
    return estimate


def pixel_features(network: Network, given: Float) -> Float:
    """Return the features (D, H, W) float32 of an input (1, 5, H, W), without dropout."""
    (features,) = network.backend.run("features", _decoded, given)
    return features[0].float().cpu().numpy()


def _decoded(module: SegmentationNetwork, image: Tensor) -> tuple[Tensor]:
    """Map a normalised range image (1, 5, H, W) to features (1, D, H, W)."""
    height, width = image.shape[-2:]
    return (module.decoded(*module.padded_trunk(image))[..., :height, :width],)
