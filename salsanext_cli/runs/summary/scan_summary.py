# SPDX-License-Identifier: MIT
"""Summary of one scan: a few numbers, which workers send to the main process."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.checks.label_checks import label_findings
from salsanext_cli.core.checks.scan_checks import UNCHECKED, ScanCheck
from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.geometry.scan_measures import measures_of
from salsanext_cli.core.labelling import LabelledScan
from salsanext_cli.core.measures.population import unit_traits
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.runs.scans.scan_file import ScanFile


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
