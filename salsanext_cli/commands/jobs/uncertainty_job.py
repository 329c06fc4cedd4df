# SPDX-License-Identifier: MIT
"""Job of `uncertainty`: a scan to labels and uncertainties of its points."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import ProjectedScan, refine_labels
from salsanext_cli.core.records import Float, Origins
from salsanext_cli.core.uncertainty.error_features import error_probability
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import Estimate
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.paths import ERROR, ORIGINS, ScanFile
from salsanext_cli.runs.results.recorded_origins import origin_array, origin_in_run
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelUncertainty:
    """Uncertainty of the pixels of a scan."""

    estimate: Estimate  # From several passes
    softmax: Float | None  # (C, H, W) of one pass, if the error model needs it


@dataclass(frozen=True, slots=True)
class UncertaintyJob:
    """Job that estimates the uncertainty of the points of scans, and labels them."""

    network: Network
    knn: KnnParameters
    method: UncertaintyMethod
    output: OutputRun
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.network.sensor, self.origins)
        return read_prepared(file, self.network, origin)

    def compute(self, files: Sequence[PreparedFile]) -> list[PixelUncertainty]:
        """Estimate the uncertainty of the pixels of scans, one after the other."""
        return [self._estimate(file) for file in files]

    def _estimate(self, prepared: PreparedFile) -> PixelUncertainty:
        file = prepared.file
        network = prepared.scan.network
        image = prepared.scan.projected.image
        estimate = self.method.estimate(network, image, file.sequence, file.stem)
        network.backend.require_finite(estimate.probabilities, file.path)
        softmax = None
        if ERROR in self.output.folders:
            (pixels,) = network.predict([prepared.scan.input], softmax=True)
            network.backend.require_finite(pixels.confidence, file.path)
            softmax = pixels.softmax
        return PixelUncertainty(estimate=estimate, softmax=softmax)

    def finish(self, prepared: PreparedFile, pixels: PixelUncertainty) -> ScanSummary:
        """Write the uncertainty of the points, and their labels unless they are of other stages."""
        file = prepared.file
        projected = prepared.scan.projected
        self._write_origin(file, projected)
        self._write_uncertainty(file, projected, pixels.estimate)
        if "predictions" not in self.output.folders:
            return ScanSummary(file=file, check=projected.check)
        return self._write_labels(prepared, pixels)

    def _write_origin(self, file: ScanFile, scan: ProjectedScan) -> None:
        if ORIGINS in self.output.folders:
            self.output.write_array(file, ORIGINS, origin_array(scan.origin))

    def _write_uncertainty(self, file: ScanFile, scan: ProjectedScan, estimate: Estimate) -> None:
        """Write each kind of uncertainty of the points, (N,) float32."""
        for kind in self.method.kinds:
            image_values = getattr(estimate.uncertainty, kind)
            values = points_from_pixels(image_values, scan.image.pixel_of_point, np.nan)
            self.output.write_array(file, f"uncertainty/{kind}", values)

    def _write_labels(self, prepared: PreparedFile, pixels: PixelUncertainty) -> ScanSummary:
        """Write the labels of the points by the mean softmax, after their probability of error."""
        file = prepared.file
        network = prepared.scan.network
        projected = prepared.scan.projected
        mean = PixelPrediction.from_softmax(pixels.estimate.probabilities)
        labels = refine_labels(prepared.scan, mean, self.knn).labels
        if pixels.softmax is not None:
            error = error_probability(network, projected.image, pixels.softmax, labels)
            self.output.write_array(file, ERROR, error)
        self.output.write_labels(file, network.space.to_raw(labels))
        return ScanSummary.from_labels(file, labels, network.space, projected.check)
