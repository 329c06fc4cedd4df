# SPDX-License-Identifier: MIT
"""Scan as the network sees it: described by features and uncertainty, or labelled."""

from dataclasses import dataclass

import numpy as np
from torch import Tensor

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.torch_engine import inference_mode
from salsanext_cli.errors import FormatError
from salsanext_cli.fitting.label_scan import LabelledScan, labelled, project_for
from salsanext_cli.fitting.scan_checks import ScanCheck
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.options import KnnParameters
from salsanext_cli.records import Double, Float, RangeImage
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.uncertainty.estimate import Estimate
from salsanext_cli.uncertainty.monte_carlo import sample


@dataclass(frozen=True, slots=True, eq=False)
class ScanDescription:
    """Means over the pixels of a scan that hold a point."""

    file: ScanFile
    # (D,) float64: of the layer before the logits, without dropout; 32 in SalsaNext
    features: Double
    uncertainty: float  # Mutual information of label and weights, nats; NaN without passes
    points: int
    check: ScanCheck  # Reasons to doubt the scan


def describe_scan(file: ScanFile, network: Network, samples: int, seed: int) -> ScanDescription:
    """Describe a scan by what the network makes of it."""
    # The masks of dropout are the same for every scan: between masks the mutual information varies
    # more than between scans of one drive.
    network, projected = project_for(network, file)
    image = projected.image
    filled = image.point_of_pixel >= 0
    if not filled.any():
        raise FormatError(file.path, "no point is in view of the sensor", "a scan with points")
    features = pixel_features(network, image)[:, filled].mean(axis=1, dtype=np.float64)
    network.engine.require_finite(features, file.path)
    mean = np.nan
    if samples:
        information = _estimate(file, image, network, samples, seed).uncertainty.mutual_information
        mean = float(information[filled].mean(dtype=np.float64))
    return ScanDescription(file, features, mean, len(projected.scan), projected.check)


def label_sampled(
    file: ScanFile, network: Network, samples: int, seed: int
) -> tuple[LabelledScan, Float]:
    """Label a scan by the mean softmax of passes; also return their information (H, W), nats."""
    network, projected = project_for(network, file)
    estimate = _estimate(file, projected.image, network, samples, seed)
    scan = labelled(projected, estimate.probabilities, network, KnnParameters())
    return scan, estimate.uncertainty.mutual_information


def _estimate(
    file: ScanFile, image: RangeImage, network: Network, samples: int, seed: int
) -> Estimate:
    estimate = sample(network, image, samples=samples, seed=seed)
    network.engine.require_finite(estimate.probabilities, file.path)
    return estimate


def pixel_features(network: Network, image: RangeImage) -> Float:
    """Return the features of every pixel of a scan, (D, H, W) float32, without dropout."""
    engine, given = network.engine, network.input(image.channels)
    if engine.library == "openvino":
        return engine.graph("features", _decoded)(given)[0][0]
    with inference_mode(engine.device):
        decoded = _decoded(engine.torch_module, engine.tensor(given))
        return decoded[0].float().cpu().numpy()


def _decoded(module: SegmentationNetwork, image: Tensor) -> Tensor:
    """Map a normalised range image (1, 5, H, W) to features (1, D, H, W)."""
    height, width = image.shape[-2:]
    return module.decoded(*module.padded_trunk(image))[..., :height, :width]
