# SPDX-License-Identifier: MIT
"""Summary of a run over scans, from a few numbers about each."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.label_checks import label_findings
from salsanext_cli.core.checks.scan_checks import UNCHECKED, ScanCheck
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.scan_measures import measures_of
from salsanext_cli.core.geometry.scan_traits import ScanTraits
from salsanext_cli.core.labelling import LabelledScan
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy, expected_accuracy
from salsanext_cli.core.measures.population import unit_traits
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.core.network.card import AccuracyLine, RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.fit.mixed_sensors import mixed_sensors
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.selection import space_of_labels
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, hint_in, log_finding, log_text
from salsanext_cli.runs.summary.threshold_scans import (
    ThresholdComparison,
    TraitSample,
    why_incomparable,
)

CLASSES_SHOWN = 5  # Classes that a summary names
NOT_COMPARED = "the scans cannot be compared with those that the threshold was chosen on"
TUNE_AGAIN = "choose the threshold with `salsanext tune risk` on labelled scans like these"
log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanSummary:
    """Numbers of one scan; small, because workers send them to the main process."""

    file: ScanFile
    check: ScanCheck = UNCHECKED  # Reasons to doubt the scan or its labels
    class_points: Counts | None = None  # (C,): number of points by predicted train id
    # Number of points that had a label when those above a threshold were rejected
    judged_points: int = 0
    rejected_points: int = 0  # Number of points rejected by their error
    unmeasured_points: int = 0  # Number of points without a measurement
    confidence: float = math.nan  # Mean of the largest probabilities of the points
    traits: UnitTraits | None = None  # Of the scan and its labels, if a threshold rejects some

    @property
    def warning_codes(self) -> list[str]:
        """Codes of the warnings about the scan, each once, sorted."""
        return sorted({str(finding.code) for finding in self.check.findings})

    @classmethod
    def from_labels(
        cls,
        file: ScanFile,
        labels: TrainIds,
        space: LabelSpace,
        check: ScanCheck = UNCHECKED,
        confidence: float = 1.0,
    ) -> ScanSummary:
        """Count the predicted train ids (N,) of a scan; check them and their mean probability."""
        points = np.bincount(labels, minlength=space.class_count)
        findings = (*check.findings, *label_findings(points, confidence, space))
        return cls(file=file, check=replace(check, findings=findings), class_points=points)

    @classmethod
    def from_scan(cls, file: ScanFile, scan: LabelledScan, space: LabelSpace) -> ScanSummary:
        """Summarise a labelled scan, with a warning if the probabilities are low."""
        checked = scan.checked
        summary = cls.from_labels(file, scan.labels, space, checked.check, scan.mean_confidence)
        measured = measured_ranges(checked.scan.points)[1]
        return replace(summary, unmeasured_points=int(np.count_nonzero(~measured)))

    def without_rejected(self, rejected: Mask, labels: TrainIds, uncertainty: Float) -> ScanSummary:
        """Count rejected points as unlabelled; the checks stay those of all labels.

        Parameters
        ----------
        rejected : ndarray of bool (N,)
            Whether the label of each point is rejected.
        labels : ndarray of uint8 (N,)
            Train ids before that.
        uncertainty : ndarray of float32 (N,)
            Uncertainty that decided, 0…1, NaN for points without a pixel.

        Returns
        -------
        ScanSummary
        """
        count = int(rejected.sum())
        judged = int(np.count_nonzero(~np.isnan(uncertainty)))
        if self.class_points is None:
            return replace(self, rejected_points=count, judged_points=judged)
        points = self.class_points - np.bincount(labels[rejected], minlength=len(self.class_points))
        points[0] += count
        return replace(self, class_points=points, judged_points=judged, rejected_points=count)

    def with_traits(self, scan: LabelledScan, uncertainty: Float) -> ScanSummary:
        """Add the traits that `predict` compares with those of a threshold.

        Parameters
        ----------
        scan : LabelledScan
            The scan before any label is rejected.
        uncertainty : ndarray of float32 (N,)
            Uncertainty that the threshold limits, 0…1, NaN for points without a pixel.

        Returns
        -------
        ScanSummary
        """
        if self.class_points is None:
            return self
        checked = scan.checked
        measures = measures_of(checked.scan, checked.range_image(), checked.sensor)
        codes = [finding.code for finding in self.check.findings]
        name = self.file.name
        traits = unit_traits(name, self.class_points, uncertainty, measures, codes)
        return replace(self, traits=traits)


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
    class_points: Counts | None = None  # (C,): number of points by predicted train id
    # Names and findings of scans and sequences by code
    findings: dict[str, list[tuple[str, Finding]]] = field(default_factory=dict)
    traits: dict[ScanFile, ScanTraits] = field(default_factory=dict)  # Traits of the sensor by scan
    names: set[str] = field(default_factory=set)  # Names of the added scans and sequences
    # Number of points that had a label when those above a threshold were rejected
    judged_points: int = 0
    rejected_points: int = 0  # Number of points rejected by their error
    unmeasured_points: int = 0  # Number of points without a measurement
    checked_points: int = 0  # Number of points of the scans that were projected
    ego_points: int = 0  # Number of these on the housing of the sensor or its vehicle
    # Mean of the largest probabilities of the points, 0…1, by name of the scan
    confidences: dict[str, float] = field(default_factory=dict)
    # Traits of scans and their labels, to be compared with those of the threshold
    population: TraitSample = field(default_factory=TraitSample)
    # Names of scans of earlier runs whose results are in the folder, by code of their warnings
    earlier_warnings: dict[str, list[str]] = field(default_factory=dict)
    out: Path | None = None  # Folder of the results, for hints

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
        self.names.add(scan.file.name)
        self.judged_points += scan.judged_points
        self.rejected_points += scan.rejected_points
        self.unmeasured_points += scan.unmeasured_points
        self.checked_points += scan.check.points
        self.ego_points += scan.check.ego_points
        if not math.isnan(scan.confidence):
            self.confidences[scan.file.name] = scan.confidence
        for finding in scan.check.findings:
            self.add_finding(scan.file.name, finding)
        if scan.traits is not None:
            self.population.add(scan.file.name, scan.traits)
        if scan.check.traits is not None:
            self.traits[scan.file] = scan.check.traits
        if scan.class_points is not None:
            before = 0 if self.class_points is None else self.class_points
            self.class_points = before + scan.class_points

    def add_finding(self, name: str, finding: Finding) -> None:
        """Add a reason to doubt a scan; log it if it is the first of its code."""
        if finding.code not in self.findings:
            log_finding(name, finding, self.out)
        self.findings.setdefault(finding.code, []).append((name, finding))

    def add_sequence(self, name: str, findings: Iterable[Finding]) -> None:
        """Add and log reasons to doubt a whole sequence."""
        self.names.add(name)
        for finding in findings:
            log_finding(f"sequence {name}", finding, self.out)
            self.findings.setdefault(finding.code, []).append((name, finding))

    def add_findings_of(self, step: RunSummary) -> None:
        """Add the findings of a further step on these scans, at most one of each code and name."""
        for code, findings in step.findings.items():
            own_findings = self.findings.setdefault(code, [])
            names = {name for name, _ in own_findings}
            own_findings += [(name, finding) for name, finding in findings if name not in names]

    def compare_scans(self) -> None:
        """Compare the sensors of the scans added since the last call."""
        for file, finding in mixed_sensors(self.traits).items():
            self.add_finding(file.name, finding)
        self.traits.clear()
        self._compare_with_threshold()

    def _compare_with_threshold(self) -> None:
        """Warn if the scans are evidently not like those that the threshold was chosen on."""
        risk = self.threshold
        is_reported = WarningCode.OTHER_SCANS in self.findings
        if risk is None or self.space is None or not self.names or is_reported:
            return
        classes = self.space.names[1:]
        traits = self.population.chosen()
        compared = ThresholdComparison(
            files=self.scans, sensor=self.sensor, traits=traits, classes=classes
        )
        problem = compared.difference(risk)
        if problem:
            finding = Finding(WarningCode.OTHER_SCANS, problem, TUNE_AGAIN)
            first, *others = sorted(self.names)
            self.add_finding(first, finding)
            self.findings[WarningCode.OTHER_SCANS] += [(name, finding) for name in others]
        elif traits:
            reason = why_incomparable(risk, compared.units(risk))
            if reason:
                log.log(NOTICE, "%s (%s)", NOT_COMPARED, reason)
        self.population = TraitSample()

    def finished(self) -> RunSummary:
        """Compare the scans, log the number of further warnings, and return the summary."""
        self.compare_scans()
        for code, findings in sorted(self.findings.items()):
            others = sorted(name for name, _ in findings[1:] if "/" in name)
            if others:
                count = counted(len(others), "more scan")
                log.warning("%s in %s: %s", code, count, log_text(first_few(others)))
        return self

    def warnings(self) -> list[ScanWarning]:
        """Return a warning for each code, with the text of its first scan and the names of all."""
        warnings = []
        for code in sorted(self.findings):
            findings = sorted(self.findings[code], key=itemgetter(0))
            first = findings[0][1]
            warnings.append(
                ScanWarning(
                    code=code,
                    message=first.problem,
                    hint=hint_in(self.out, first.hint),
                    scans=[name for name, _ in findings],
                )
            )
        return warnings

    @property
    def ego_share(self) -> float:
        """Share of the points, 0…1, on the housing and the vehicle, over the scans of this run."""
        return self.ego_points / max(self.checked_points, 1)

    @property
    def unlabelled_share(self) -> float:
        """Share of the points, 0…1, without a label; `ego_share` if no scan is labelled."""
        points = self.class_points
        return self.ego_share if points is None else float(points[0] / max(points.sum(), 1))

    @property
    def unmeasured_share(self) -> float:
        """Share of the points, 0…1, without a measurement."""
        return self._share(self.unmeasured_points)

    @property
    def rejected_share(self) -> float:
        """Share of the points with a label, 0…1, that were rejected."""
        return self.rejected_points / max(self.judged_points, 1)

    @property
    def rejected_share_of_all(self) -> float:
        """Share of all points, 0…1, that were rejected."""
        return self._share(self.rejected_points)

    def _share(self, count: int) -> float:
        """Return a number of points as a share of all points, 0…1."""
        total = 0 if self.class_points is None else int(self.class_points.sum())
        return count / max(total, 1)

    def expected_accuracy(self) -> ExpectedAccuracy | None:
        """Return the estimated accuracy of this run, None if the weights contain no estimate."""
        warnings = {code: {*names} for code, names in self.earlier_warnings.items()}
        for code, findings in self.findings.items():
            warnings.setdefault(code, set()).update(name for name, _ in findings)
        return expected_accuracy(self.accuracy, self.confidences, warnings)

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the points, 0…1, of the largest predicted classes, by name."""
        if self.space is None or self.class_points is None:
            return {}
        return largest_classes(self.space, self.class_points)


def guarantee_of_run(
    out: Path, space: LabelSpace, losses: Mapping[str, AcceptedCounts]
) -> RiskBoundCheck | None:
    """Compare the guarantee of a run with labels; None if the run has none.

    Parameters
    ----------
    out : Path
        Output folder of `predict --reject risk`.
    space : LabelSpace
        Classes of the labels.
    losses : mapping of str to AcceptedCounts
        Points of each scan by name.

    Returns
    -------
    RiskBoundCheck or None
    """
    findings = OwnedFolder(out, "predict").findings()
    codes = {finding.code for name in losses for finding in findings.get(name, ())}
    threshold = Manifest(out).risk_threshold(space)
    check = RiskBoundCheck.from_scans(
        threshold, losses, are_others=WarningCode.OTHER_SCANS in codes
    )
    if check is None or threshold is None:
        return None
    return replace(check, incomparable=why_incomparable(threshold, check.units))


def largest_classes(space: LabelSpace, points: Counts) -> dict[str, float]:
    """Return the shares, 0…1, of the largest classes except class 0, by name.

    `points` (C,): number of points by train id.
    """
    largest = np.argsort(-points[1:], kind="stable")[:CLASSES_SHOWN] + 1
    return {space.names[i]: float(points[i] / points.sum()) for i in largest if points[i]}
