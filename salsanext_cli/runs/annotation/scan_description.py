# SPDX-License-Identifier: MIT
"""Description of a scan by features and uncertainty of the network."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from torch import Tensor

from salsanext_cli.core.checks.scan_checks import ScanCheck
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.labelling import PreparedScan
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import Double, Float, Origin, Origins
from salsanext_cli.core.uncertainty.monte_carlo import Estimate, sample
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ScanDescription:
    """Means over the occupied pixels of a scan."""

    file: ScanFile
    features: Double  # (D,) float64: input of the last layer, without dropout; 32 in SalsaNext
    uncertainty: float  # Mutual information of label and weights in nats
    check: ScanCheck  # Reasons to doubt the scan
    frame: Origin  # Of its points, as its file states it, metres


@dataclass(frozen=True, slots=True)
class DescribeJob:
    """Job that describes scans, with `samples` passes of dropout."""

    network: Network
    samples: int
    seed: int
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan."""
        prepared = read_prepared(file, self.network, self.origins.get(file.name))
        if not (prepared.scan.projected.image.point_of_pixel >= 0).any():
            raise FormatError(file.path, "has no point in the field of view of the sensor")
        return prepared

    def compute(self, files: Sequence[PreparedFile]) -> list[tuple[Float, Float]]:
        """Return features (D, H, W) and mutual information (H, W) of each scan."""
        computed = []
        for file in files:
            scan = file.scan
            # Every scan has the same masks of dropout, because the mutual information varies more
            # between masks than between scans of one drive.
            estimate = checked_sample(scan, self.samples, self.seed)
            information = estimate.uncertainty.mutual_information
            computed.append((pixel_features(scan.network, scan.input), information))
        return computed

    def finish(self, prepared: PreparedFile, computed: tuple[Float, Float]) -> ScanDescription:
        """Return the means over the occupied pixels."""
        projected = prepared.scan.projected
        features_of_pixel, information = computed
        occupied = projected.image.point_of_pixel >= 0
        features = features_of_pixel[:, occupied].mean(axis=1, dtype=np.float64)
        prepared.scan.network.backend.require_finite(features, projected.source)
        mean = float(information[occupied].mean(dtype=np.float64))
        return ScanDescription(
            file=prepared.file,
            features=features,
            uncertainty=mean,
            check=projected.check,
            frame=projected.scan.notes.frame,
        )


def checked_sample(scan: PreparedScan, samples: int, seed: int) -> Estimate:
    """Estimate by Monte-Carlo dropout; `WeightsError` if the result is not finite."""
    projected = scan.projected
    estimate = sample(scan.network, projected.image, samples=samples, seed=seed)
    scan.network.backend.require_finite(estimate.probabilities, projected.source)
    return estimate


def pixel_features(network: Network, image: Float) -> Float:
    """Return the features (D, H, W) float32 of an input (1, 5, H, W), without dropout."""
    (features,) = network.backend.run("features", _decoded, image)
    return features[0].float().cpu().numpy()


def _decoded(module: SegmentationNetwork, image: Tensor) -> tuple[Tensor]:
    """Map a normalised range image (1, 5, H, W) to features (1, D, H, W)."""
    height, width = image.shape[-2:]
    return (module.decoded(*module.padded_trunk(image))[..., :height, :width],)
