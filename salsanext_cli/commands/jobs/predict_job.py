# SPDX-License-Identifier: MIT
"""Job of `predict`: the way of a scan from its file to its results.

1. `PredictJob.prepare` reads a scan by `read_to_label` of `runs/fit/scan_reading.py`, checks it and
   makes the input of the network.
2. `PredictJob.compute` computes a batch.
3. `PredictJob.finish` writes the results of the points.

The steps but reading and writing are those of a `Labeller` of `core/labellers.py`, whose
`label_scan` takes them in memory. On a CPU, the kernels project a scan in the first step, and
refine its labels in the third; a GPU does both in the second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from salsanext_cli.commands.jobs.label_rejection import LabelRejection
from salsanext_cli.commands.jobs.object_table import object_table
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.objects import find_objects
from salsanext_cli.core.labellers import Labeller, labeller_for
from salsanext_cli.core.labelling import LabelledScan, LabelRequest
from salsanext_cli.core.records import Float, Origins
from salsanext_cli.runs.fit.scan_reading import FileToLabel, read_to_label
from salsanext_cli.runs.results.folder_names import ERROR, LEAST_CONFIDENCE, ORIGINS
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import origin_array, origin_in_run
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_summary import ScanSummary

NEED_SOFTMAX = {"probabilities", "votes"}  # Results that need the whole softmax of the points
UncertaintyByKind = dict[str, Float]  # (N,) float32, 0…1, NaN for points without a pixel


@dataclass(frozen=True, slots=True)
class PredictJob:
    """Job that labels the points of scans and writes the requested results, the labels last."""

    network: Network
    knn: KnnParameters
    output: OutputRun
    reject: LabelRejection | None = None
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    @property
    def labeller(self) -> Labeller:
        """Way of the scans to the results."""
        readers = NEED_SOFTMAX & {*self.output.folders}
        request = LabelRequest(
            knn=self.knn,
            softmax=bool(readers),
            half_softmax=readers == {"probabilities"},
            error=ERROR in self.output.folders,
        )
        return labeller_for(self.network, request)

    def prepare(self, file: ScanFile) -> FileToLabel:
        """Read and check a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        origin = origin_in_run(self.output, file, self.network.sensor, self.origins)
        return read_to_label(file, self.labeller, origin)

    def compute(self, files: Sequence[FileToLabel]) -> Sequence[Any]:
        """Compute the results of scans."""
        return self.labeller.compute([file.scan for file in files])

    def finish(self, prepared: FileToLabel, computed: Any) -> ScanSummary:
        """Write the results of the points; return numbers about the scan."""
        file = prepared.file
        scan = self.labeller.finish(prepared.scan, computed)
        self._write_origin(file, scan)
        self._write_pixel_labels(file, scan)
        self._write_softmax(file, scan)
        uncertainty = self._write_uncertainty(file, scan)
        summary = self._summary(file, scan, uncertainty)
        if self.reject is not None:
            scan = self.reject.applied(scan, uncertainty[self.reject.kind])
        self._write_labels(file, scan)
        return summary

    def _write_origin(self, file: ScanFile, scan: LabelledScan) -> None:
        if ORIGINS in self.output.folders:
            self.output.write_array(file, ORIGINS, origin_array(scan.checked.origin))

    def _write_pixel_labels(self, file: ScanFile, scan: LabelledScan) -> None:
        if "pixel_labels" in self.output.folders:
            self.output.write_array(file, "pixel_labels", scan.pixel_labels)

    def _write_softmax(self, file: ScanFile, scan: LabelledScan) -> None:
        """Write the softmax of the points, or its largest probabilities for `fuse`."""
        if scan.softmax is None:
            return
        if "probabilities" in self.output.folders:
            probabilities = scan.softmax.astype(np.float16, copy=False)
            self.output.write_array(file, "probabilities", probabilities)
        if "votes" in self.output.folders:
            # Only labels that are to be fused need a part of `fusion`.
            from salsanext_cli.core.fusion.top_classes import top_classes

            self.output.write_array(file, "votes", top_classes(scan.softmax))

    def _write_uncertainty(self, file: ScanFile, scan: LabelledScan) -> UncertaintyByKind:
        """Write and return the least confidence, and the probability of error if requested."""
        self.output.write_array(file, LEAST_CONFIDENCE, scan.least_confidence)
        uncertainty = {"least_confidence": scan.least_confidence}
        if scan.error is not None:
            self.output.write_array(file, ERROR, scan.error)
            uncertainty["error"] = scan.error
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
            objects = find_objects(scan.checked.range_image(), scan.labels, space.movable)
            path = self.output.path(file, "objects")
            self.output.write(path, object_table(scan, objects, space))
            raw |= objects.astype(np.uint32) << 16
        self.output.write_labels(file, raw)


def _mean_confidence(least_confidence: Float) -> float:
    """Return the mean confidence of points (N,) with a pixel, 0…1; NaN without any."""
    on_image = least_confidence[~np.isnan(least_confidence)]
    return 1 - float(on_image.mean()) if on_image.size else np.nan
