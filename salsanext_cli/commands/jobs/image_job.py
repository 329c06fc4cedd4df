# SPDX-License-Identifier: MIT
"""Job of `predict` on the output of `project`: a range image to labels of its pixels."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.checks.scan_checks import ScanCheck, check_image
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.records import Float
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.fit.range_images import range_image
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.recorded_origins import sensor_of_result
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_summary import ScanSummary


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedImage:
    """Range image of `project`, ready for a network."""

    file: ScanFile
    input: Float  # (1, 5, H, W) float32, normalised, for the sensor of the scan
    check: ScanCheck  # Reasons to doubt the scan


@dataclass(frozen=True, slots=True)
class PredictImageJob:
    """Job that labels the pixels of range images in a folder."""

    network: Network
    folder: Path
    output: OutputRun

    def prepare(self, file: ScanFile) -> PreparedImage:
        """Read and check a range image, whose sensor may depend on the scan."""
        self.output.require_replaceable(file)
        network = self.network
        if network.sensor.others:
            scan = read_scan(file.path, network.sensor)
            scan_sensor = sensor_of_result(self.folder, file, scan, network.sensor)
            network = network.for_sensor(scan_sensor)
        image = range_image(file, self.folder, network.sensor)
        check = check_image(image, network.sensor, network.card.sensor)
        return PreparedImage(file=file, input=network.input(image), check=check)

    def compute(self, scans: Sequence[PreparedImage]) -> list[PixelPrediction]:
        """Predict the pixels of images."""
        return self.network.predict([scan.input for scan in scans])

    def finish(self, scan: PreparedImage, pixels: PixelPrediction) -> ScanSummary:
        """Write the labels of the pixels."""
        path = output_path(self.folder, scan.file.sequence, "range", scan.file.stem)
        self.network.backend.require_finite(pixels.confidence, path)
        self.output.write_array(scan.file, "pixel_labels", pixels.labels)
        return ScanSummary(file=scan.file, check=scan.check)
