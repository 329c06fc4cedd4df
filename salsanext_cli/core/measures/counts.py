# SPDX-License-Identifier: MIT
"""Counts of the points of scans by label, prediction, probability, uncertainty and distance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from operator import add
from typing import Any, TypeVar

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.point_sample import measured_ranges
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts
from salsanext_cli.core.measures.histograms import Histogram, lack_of_confidence, softmax_entropy
from salsanext_cli.core.measures.scores import Counts, accepted, scored_rows
from salsanext_cli.core.records import Float, Indices
from salsanext_cli.core.texts import counted, first_few, percentage, with_hint
from salsanext_cli.core.uncertainty.kinds import UNCERTAINTY
from salsanext_cli.core.wording import argument

SOFTMAX = "probabilities"  # Folder of the softmax, and key of the histograms of its confidence
OF_SOFTMAX = {"least_confidence": lack_of_confidence, "softmax_entropy": softmax_entropy}
"""Uncertainties computed from the probabilities if no file has them or classes are merged."""
EVALUATED_KINDS = tuple(dict.fromkeys([*OF_SOFTMAX, *UNCERTAINTY]))  # In the order of reports
OF_ERROR = "error calibration"  # Key of the histogram of the error as a probability
MIN_ACCURACY = 0.2
"""Least accuracy of labels with the same raw ids as the predictions; other ids had 0.02, the
default weights 0.75 or more in cities."""
MIN_JUDGED = 10_000  # Fewest points that show the accuracy
BAND_STARTS_M = (0.0, 10.0, 20.0, 30.0, 40.0, 50.0)  # The last band has no end
BAND_NAMES = ("0–10 m", "10–20 m", "20–30 m", "30–40 m", "40–50 m", "over 50 m")


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanScores:
    """Scores of one scan, as in `Scores`."""

    points: int
    accuracy: float
    iou_mean_present: float


@dataclass(slots=True, kw_only=True)
class ScanCounts:
    """Counts over scans."""

    confusion: Counts  # (C, C) of all points
    bands: tuple[Counts, ...] = ()  # (C, C) for each of `BAND_NAMES`; empty if not requested
    # Number of points by raw id that the label space lacks
    unknown_truth: Counter[int] = field(default_factory=Counter)
    unknown_predictions: Counter[int] = field(default_factory=Counter)
    scans: int = 0  # Number of scans counted
    training_scans: int = 0  # Number of counted scans that the weights were trained on
    # Number of scans that are not counted because the weights were trained on them
    skipped_training_scans: int = 0
    threshold_scans: int = 0  # Number of counted scans that the threshold was chosen on
    missing: list[str] = field(default_factory=list)  # Names of scans without predictions
    files: Counter[str] = field(default_factory=Counter)  # Number of scans with a file, by folder
    # Points of each scan of a run that rejected labels, by name
    accepted: dict[str, AcceptedCounts] = field(default_factory=dict)
    calibration_errors: list[float] = field(default_factory=list)  # Of each scan with a softmax
    # By kind of uncertainty, `SOFTMAX` for the confidence, or `OF_ERROR`
    histograms: dict[str, Histogram] = field(default_factory=dict)
    by_sequence: dict[str, Counts] = field(default_factory=dict)
    by_scan: dict[str, ScanScores] = field(default_factory=dict)  # By name of the scan

    @classmethod
    def none(cls, space: LabelSpace, by_distance: bool = False) -> ScanCounts:
        """Return the counts of no scan, with or without bands of distance."""
        empty = np.zeros((space.class_count, space.class_count), np.int64)
        bands = tuple(empty.copy() for _ in BAND_NAMES) if by_distance else ()
        return cls(confusion=empty, bands=bands)

    def add(self, other: ScanCounts) -> None:
        """Add the counts of other scans, which are used up."""
        self.confusion += other.confusion
        self.bands = tuple(map(add, self.bands, other.bands))
        self.unknown_truth += other.unknown_truth
        self.unknown_predictions += other.unknown_predictions
        self.files += other.files
        self.scans += other.scans
        self.training_scans += other.training_scans
        self.skipped_training_scans += other.skipped_training_scans
        self.threshold_scans += other.threshold_scans
        self.missing += other.missing
        self.calibration_errors += other.calibration_errors
        self.accepted |= other.accepted
        self.by_scan |= other.by_scan
        _add_by_key(self.histograms, other.histograms)
        _add_by_key(self.by_sequence, other.by_sequence)

    def label_warnings(self, space: LabelSpace) -> Iterator[str]:
        """Yield reasons to doubt the scores, in words."""
        if self.skipped_training_scans:
            scans = self.scans + self.skipped_training_scans
            share = f"{self.skipped_training_scans:,} of {counted(scans, 'labelled scan')}"
            yield f"{share} skipped: the weights were trained on them"
        elif self.training_scans:
            yield "the weights were trained on every labelled scan: scores on new scans are unknown"
        if self.threshold_scans:
            chosen = f"{self.threshold_scans:,} of {counted(self.scans, 'scan')}"
            yield f"the threshold was chosen on {chosen}: these scans do not test its guarantee"
        unknown = {"labels": self.unknown_truth, "predictions": self.unknown_predictions}
        for source, ids in unknown.items():
            if ids:
                listed = first_few([f"{i} ({count:,}×)" for i, count in sorted(ids.items())])
                yield f"{source}: unknown ids {listed} count as unlabelled"
        matrix = scored_rows(self.confusion, space)
        matrix = accepted(matrix) if self.accepted else matrix
        points = int(matrix.sum())
        right = int(np.trace(matrix))
        if points >= MIN_JUDGED and right < MIN_ACCURACY * points:
            labelled = f"{percentage(right / points)} of the labelled points"
            agreement = f"labels and predictions agree on {labelled}"
            hint = f"check {argument('label_space')} and the settings of the sensor"
            yield with_hint(agreement, hint)


Sum = TypeVar("Sum", Histogram, Counts)


def _add_by_key(sums: dict[Any, Sum], others: Mapping[Any, Sum]) -> None:
    for key, other in others.items():
        if key in sums:
            sums[key] += other
        else:
            sums[key] = other


class SeparateCounts:
    """Counts of scans that the weights were trained on, and of the other scans."""

    def __init__(self, space: LabelSpace, by_distance: bool = False) -> None:
        self.training = ScanCounts.none(space, by_distance)
        self.others = ScanCounts.none(space, by_distance)

    def add(self, scan: ScanCounts) -> None:
        """Add the counts of one scan, which are used up."""
        if scan.training_scans:
            self.training.add(scan)
        else:
            self.others.add(scan)

    def scored(self) -> ScanCounts:
        """Return the counts of the other scans, or of all if the weights were trained on all."""
        if self.others.scans or not self.training.scans:
            self.others.skipped_training_scans = self.training.scans
            return self.others
        self.training.missing = self.others.missing
        return self.training


def band_of_point(points: Float) -> Indices:
    """Return indices into `BAND_NAMES` of points (N, 3) in metres; -1 without a measurement."""
    ranges, measured = measured_ranges(points)
    return np.where(measured, np.digitize(np.nan_to_num(ranges), BAND_STARTS_M) - 1, -1)
