# SPDX-License-Identifier: MIT
"""Summary of a run over scans, from a few numbers about each."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.scan_traits import ScanTraits
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy, expected_accuracy
from salsanext_cli.core.network.card import AccuracyLine, RiskThreshold
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.fit.mixed_sensors import mixed_sensors
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import space_of_labels
from salsanext_cli.runs.summary.run_counts import RunCounts
from salsanext_cli.runs.summary.run_findings import RunFindings
from salsanext_cli.runs.summary.scan_summary import ScanSummary
from salsanext_cli.runs.summary.scan_warnings import ScanWarning
from salsanext_cli.runs.summary.threshold_scans import ThresholdComparison, TraitSample


@dataclass(slots=True, kw_only=True)
class RunSummary:
    """Summary of the scans of a run."""

    sensor: Sensor  # Sensor that the scans were projected for
    space: LabelSpace | None = None  # Classes of the predicted points, if any are predicted
    # Scans of the run; the data set of the first may describe others
    scans: Sequence[ScanFile] = ()
    accuracy: AccuracyLine | None = None  # As in `WeightsCard`
    threshold: RiskThreshold | None = None  # Threshold of the run, whose scans these should be like
    trained: Sensor | None = None  # Sensor of the weights, if they labelled the scans
    counts: RunCounts = field(default_factory=RunCounts)
    findings: RunFindings = field(default_factory=RunFindings)
    traits: dict[ScanFile, ScanTraits] = field(default_factory=dict)  # Traits of the sensor by scan
    names: set[str] = field(default_factory=set)  # Names of the added scans and sequences
    # Traits of scans and their labels, to be compared with those of the threshold
    population: TraitSample = field(default_factory=TraitSample)

    @classmethod
    def from_network(
        cls,
        network: Network,
        scans: Sequence[ScanFile],
        accuracy: AccuracyLine | None = None,
        threshold: RiskThreshold | None = None,
    ) -> RunSummary:
        """Return the summary of scans that a network labels."""
        return cls(
            sensor=network.sensor,
            space=network.space,
            scans=scans,
            accuracy=accuracy,
            threshold=threshold,
            trained=network.card.sensor,
        )

    @property
    def has_point_labels(self) -> bool:
        """Whether the run labelled points, and not pixels, whose classes are not counted."""
        return self.space is not None

    @property
    def labelled(self) -> bool:
        """Whether the first scan has labels that `eval` can compare with those of the run."""
        if not self.scans:
            return False
        path = self.scans[0].label_path
        if not present(path):
            return False
        if self.space is None:
            return True
        space = space_of_labels(self.scans, self.space)
        try:
            space.to_train(read_labels(path), strict=False, source=path)
        except SalsanextError:
            return False
        return True

    def add(self, scan: ScanSummary) -> None:
        """Add a scan; log the first finding of each code at once."""
        name = scan.file.name
        self.names.add(name)
        self.counts.add(scan)
        for finding in scan.check.findings:
            self.findings.add(name, finding)
        if scan.traits is not None:
            self.population.add(name, scan.traits)
        if scan.check.traits is not None:
            self.traits[scan.file] = scan.check.traits

    def add_sequence(self, name: str, findings: Iterable[Finding]) -> None:
        """Add and log reasons to doubt a whole sequence."""
        self.names.add(name)
        self.findings.add_of_sequence(name, findings)

    def compare_scans(self) -> None:
        """Compare the sensors of the scans added since the last call."""
        for file, finding in mixed_sensors(self.traits).items():
            self.findings.add(file.name, finding)
        self.traits.clear()
        self._compare_with_threshold()

    def _compare_with_threshold(self) -> None:
        """Warn if the scans are evidently not like those that the threshold was chosen on."""
        is_reported = WarningCode.OTHER_SCANS in self.findings.by_code
        if self.threshold is None or self.space is None or not self.names or is_reported:
            return
        compared = ThresholdComparison(
            files=self.scans,
            sensor=self.sensor,
            traits=self.population.chosen(),
            classes=self.space.names[1:],
        )
        finding = compared.finding(self.threshold)
        if finding is not None:
            self.findings.add_of_all(self.names, finding)
        self.population = TraitSample()

    def finished(self) -> RunSummary:
        """Compare the scans, log the number of further warnings, and return the summary."""
        self.compare_scans()
        self.findings.log_numbers()
        return self

    def warnings(self) -> list[ScanWarning]:
        """Return a warning for each code, with the text of its first scan and the names of all."""
        return self.findings.warnings()

    def expected_accuracy(self) -> ExpectedAccuracy | None:
        """Return the estimated accuracy of this run, None if the weights contain no estimate."""
        warned = self.findings.names_by_code()
        return expected_accuracy(self.accuracy, self.counts.confidences, warned)
