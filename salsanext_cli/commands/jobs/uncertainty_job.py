# SPDX-License-Identifier: MIT
"""Job of `uncertainty`: a scan to labels and uncertainties of its points.

The steps but reading and writing are those of an `Estimator` of `core/estimators.py`. On a CPU, the
kernels project a scan in the first step, and refine its labels in the third; a GPU does both in the
second.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.estimators import Estimator, estimator_for
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labelling import EstimatedScan
from salsanext_cli.core.records import Origins
from salsanext_cli.core.uncertainty.estimate_request import EstimateRequest
from salsanext_cli.core.uncertainty.method import UncertaintyMethod
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.runs.fit.scan_reading import FileToLabel, read_measured
from salsanext_cli.runs.results.folder_names import ERROR, ORIGINS
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import origin_array, origin_in_run
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True)
class UncertaintyJob:
    """Job that estimates the uncertainty of the points of scans, and labels them."""

    network: Network
    knn: KnnParameters
    method: UncertaintyMethod
    output: OutputRun
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses

    @property
    def estimator(self) -> Estimator:
        """Way of the scans to the results."""
        request = EstimateRequest(
            method=self.method,
            knn=self.knn,
            labels="predictions" in self.output.folders,
            error=ERROR in self.output.folders,
        )
        return estimator_for(self.network, request)

    def prepare(self, file: ScanFile) -> FileToLabel:
        """Read and check a scan whose results may be replaced."""
        self.output.require_replaceable(file)
        sensor = self.network.sensor
        origin = origin_in_run(self.output, file, sensor, self.origins)
        scan = read_measured(file.path, sensor)
        seed = scan_seed(self.method.seed, file.sequence, file.stem)
        prepared = self.estimator.prepare(scan, seed, origin, file.path)
        return FileToLabel(file=file, scan=prepared)

    def compute(self, files: Sequence[FileToLabel]) -> Sequence[Any]:
        """Estimate the uncertainty of scans."""
        return self.estimator.compute([file.scan for file in files])

    def finish(self, prepared: FileToLabel, computed: Any) -> ScanSummary:
        """Write the uncertainty of the points, and their labels unless they are of other stages."""
        file = prepared.file
        scan = self.estimator.finish(prepared.scan, computed)
        if ORIGINS in self.output.folders:
            self.output.write_array(file, ORIGINS, origin_array(scan.checked.origin))
        for kind, values in scan.uncertainty.items():
            self.output.write_array(file, f"uncertainty/{kind}", values)
        if scan.labels is None:
            return ScanSummary(file=file, check=scan.checked.check)
        return self._write_labels(file, scan, scan.labels)

    def _write_labels(self, file: ScanFile, scan: EstimatedScan, labels: TrainIds) -> ScanSummary:
        """Write the labels of the points, after their probability of error."""
        space = self.network.space
        if scan.error is not None:
            self.output.write_array(file, ERROR, scan.error)
        self.output.write_labels(file, space.to_raw(labels))
        return ScanSummary.from_labels(file, labels, space, scan.checked.check)
