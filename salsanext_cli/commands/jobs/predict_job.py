# SPDX-License-Identifier: MIT
"""Job of `predict`: the way of a scan from its file to its results.

1. `PredictJob.prepare` reads, checks and projects it: `read_prepared` calls `read_measured`,
   `project_scan` and `prepare_for`.
2. `PredictJob.compute` labels the pixels of a batch: `predict_pixels`.
3. `PredictJob.finish` refines the labels on the points, `refine_labels`, and writes the results.

`core/labelling.py` has all these steps but the reading; its `label_scan` takes them in memory.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from salsanext_cli.commands.jobs.label_rejection import LabelRejection
from salsanext_cli.commands.jobs.object_table import object_table
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.objects import find_objects
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import LabelledScan, predict_pixels, refine_labels
from salsanext_cli.core.records import Float, Origins
from salsanext_cli.core.uncertainty.error_features import error_probability
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.paths import ERROR, LEAST_CONFIDENCE, ORIGINS, ScanFile
from salsanext_cli.runs.results.recorded_origins import origin_array, origin_in_run
from salsanext_cli.runs.summary.scan_summary import ScanSummary

NEED_SOFTMAX = {"probabilities", "votes", ERROR}  # Results that need the whole softmax
UncertaintyByKind = dict[str, Float]  # (N,) float32, 0…1, NaN for points without a pixel


@dataclass(frozen=True, slots=True)
class PredictJob:
    """Job that labels the points of scans and writes the requested results, the labels last."""

    network: Network
    knn: KnnParameters
    output: OutputRun
    reject: LabelRejection | None = None
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.network.sensor, self.origins)
        return read_prepared(file, self.network, origin)

    def compute(self, files: Sequence[PreparedFile]) -> list[PixelPrediction]:
        """Predict the pixels of scans, with the softmax if a result needs it."""
        softmax = bool(NEED_SOFTMAX & {*self.output.folders})
        return predict_pixels(self.network, [file.scan for file in files], softmax=softmax)

    def finish(self, prepared: PreparedFile, pixels: PixelPrediction) -> ScanSummary:
        """Refine the labels on the points and write the results; return numbers about the scan."""
        file = prepared.file
        scan = refine_labels(prepared.scan, pixels, self.knn)
        self._write_origin(file, scan)
        self._write_pixel_labels(file, scan)
        self._write_softmax(file, scan)
        uncertainty = self._write_uncertainty(file, scan, prepared.scan.network)
        summary = self._summary(file, scan, uncertainty)
        if self.reject is not None:
            scan = self.reject.applied(scan, uncertainty[self.reject.kind])
        self._write_labels(file, scan)
        return summary

    def _write_origin(self, file: ScanFile, scan: LabelledScan) -> None:
        if ORIGINS in self.output.folders:
            self.output.write_array(file, ORIGINS, origin_array(scan.projected.origin))

    def _write_pixel_labels(self, file: ScanFile, scan: LabelledScan) -> None:
        if "pixel_labels" in self.output.folders:
            self.output.write_array(file, "pixel_labels", scan.pixels.labels)

    def _write_softmax(self, file: ScanFile, scan: LabelledScan) -> None:
        """Write the softmax of the points, or its largest probabilities for `fuse`."""
        folders = {"probabilities", "votes"} & {*self.output.folders}
        if scan.pixels.softmax is None or not folders:
            return
        pixel_of_point = scan.projected.image.pixel_of_point
        unlabelled = np.eye(1, self.network.space.class_count)
        softmax = points_from_pixels(scan.pixels.softmax, pixel_of_point, unlabelled)
        if "probabilities" in folders:
            self.output.write_array(file, "probabilities", softmax.astype(np.float16))
        if "votes" in folders:
            # Only labels that are to be fused need a part of `fusion`.
            from salsanext_cli.core.fusion.top_classes import top_classes

            self.output.write_array(file, "votes", top_classes(softmax))

    def _write_uncertainty(
        self, file: ScanFile, scan: LabelledScan, network: Network
    ) -> UncertaintyByKind:
        """Write and return the least confidence, and the probability of error if requested.

        `network`: network for the sensor of the scan.
        """
        image = scan.projected.image
        pixels = scan.pixels
        least_confidence = points_from_pixels(1 - pixels.confidence, image.pixel_of_point, np.nan)
        self.output.write_array(file, LEAST_CONFIDENCE, least_confidence)
        uncertainty = {"least_confidence": least_confidence}
        if ERROR in self.output.folders and pixels.softmax is not None:
            error = error_probability(network, image, pixels.softmax, scan.labels)
            self.output.write_array(file, ERROR, error)
            uncertainty["error"] = error
        return uncertainty

    def _summary(
        self, file: ScanFile, scan: LabelledScan, uncertainty: UncertaintyByKind
    ) -> ScanSummary:
        """Return numbers about a scan whose labels are not rejected yet."""
        summary = ScanSummary.from_scan(file, scan, self.network.space)
        confidence = _mean_confidence(uncertainty["least_confidence"])
        summary = replace(summary, confidence=confidence)
        if self.reject is None:
            return summary
        values = uncertainty[self.reject.kind]
        if self.reject.risk:
            summary = summary.with_traits(scan, values)
        return summary.without_rejected(self.reject.rejected(values), scan.labels, values)

    def _write_labels(self, file: ScanFile, scan: LabelledScan) -> None:
        """Write the labels, with the numbers of objects in the upper 16 bits if requested."""
        space = self.network.space
        raw = space.to_raw(scan.labels)
        if "objects" in self.output.folders:
            objects = find_objects(scan.projected.image, scan.labels, space.movable)
            path = self.output.path(file, "objects")
            self.output.write(path, object_table(scan, objects, space))
            raw |= objects.astype(np.uint32) << 16
        self.output.write_labels(file, raw)


def _mean_confidence(least_confidence: Float) -> float:
    """Return the mean confidence of points (N,) with a pixel, 0…1; NaN without any."""
    on_image = least_confidence[~np.isnan(least_confidence)]
    return 1 - float(on_image.mean()) if on_image.size else np.nan
