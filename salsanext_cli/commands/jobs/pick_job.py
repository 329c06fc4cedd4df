# SPDX-License-Identifier: MIT
"""Job of `pick`: a picked scan to its copy, and a coloured cloud with pre-labels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.labelling import refine_labels
from salsanext_cli.core.records import Origin, Origins
from salsanext_cli.core.uncertainty.monte_carlo import Estimate
from salsanext_cli.io.formats.kitti_labels import encode_labels
from salsanext_cli.report.picked import picked_cloud
from salsanext_cli.runs.annotation.picked_data_set import PickedDataSet
from salsanext_cli.runs.annotation.scan_description import checked_sample
from salsanext_cli.runs.fit.scan_reading import PreparedFile, read_prepared
from salsanext_cli.runs.scans.scan_file import ScanFile


@dataclass(frozen=True, slots=True, kw_only=True)
class PreLabel:
    """Pre-labels of a scan."""

    scan: ScanFile
    content: bytes  # Of a label file


@dataclass(frozen=True, slots=True)
class PickJob:
    """Job that writes picked scans, and coloured clouds with pre-labels."""

    network: Network
    seed: int
    samples: int  # Passes of Monte-Carlo dropout
    data_set: PickedDataSet
    origins: Origins = field(default_factory=dict)  # Of registered scans with poses
    # Frames in files beside the scans, metres
    beside: Mapping[ScanFile, Origin] = field(default_factory=dict)
    # Recorded frame of each picked scan that could be read for it, metres
    recorded: Mapping[ScanFile, Origin] = field(default_factory=dict)

    def prepare(self, file: ScanFile) -> PreparedFile:
        """Read, check and project a scan."""
        return read_prepared(file, self.network, self.origins.get(file.name))

    def compute(self, files: Sequence[PreparedFile]) -> list[Estimate]:
        """Sample each scan."""
        return [checked_sample(file.scan, self.samples, self.seed) for file in files]

    def finish(self, prepared: PreparedFile, estimate: Estimate) -> PreLabel:
        """Write the scan and its cloud; return the pre-labels by the mean softmax."""
        file = prepared.file
        network = prepared.scan.network
        pixels = PixelPrediction.from_softmax(estimate.probabilities)
        labelled = refine_labels(prepared.scan, pixels, KnnParameters())
        recorded = self.recorded.get(file)
        self.data_set.write_points(file, network.sensor, self.beside, recorded)
        cloud = picked_cloud(labelled, estimate.uncertainty.mutual_information, network.space)
        self.data_set.write_missing(self.data_set.paths(file.sequence, file.stem).cloud, cloud)
        raw = network.space.to_raw(labelled.labels)
        return PreLabel(scan=file, content=encode_labels(raw))
