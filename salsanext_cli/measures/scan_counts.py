# SPDX-License-Identifier: MIT
"""Counts of the points of scans by label, prediction, probability and uncertainty."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.npy import read_probabilities, read_uncertainty
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.calibration import ConfidenceHistogram, SoftmaxErrors, softmax_errors
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.distance import RING_NAMES, ring_of_point
from salsanext_cli.measures.grouped_histogram import GroupedHistogram
from salsanext_cli.measures.reliability import SCAN_BINS, reliability
from salsanext_cli.measures.softmax import lack_of_confidence, softmax_entropy
from salsanext_cli.measures.uncertainty_histogram import UncertaintyHistogram
from salsanext_cli.records import Float
from salsanext_cli.storage.layout import SUFFIX_OF_FOLDER, ScanFile, output_path

UNCERTAINTY = "uncertainty/"
FOLDERS = ("probabilities", *(f for f in SUFFIX_OF_FOLDER if f.startswith(UNCERTAINTY)))
"""Folders of the output folder that are read beside the predictions."""
OF_SOFTMAX = {"confidence": lack_of_confidence, "softmax_entropy": softmax_entropy}
"""Uncertainties that come from the probabilities."""
KINDS = (*OF_SOFTMAX, *(folder.removeprefix(UNCERTAINTY) for folder in FOLDERS[1:]))
"""Every kind of uncertainty, in the order in which they are reported."""
CLASS, RING = "class", "ring"
"""Names of the groupings of points."""
NO_RING = len(RING_NAMES)
"""The group of points without a measurement."""

Key = TypeVar("Key")
Histogram = TypeVar("Histogram", bound=GroupedHistogram)
Groups = dict[str, tuple[npt.NDArray[Any], int]]
"""The group of every point and the number of groups, by grouping."""


@dataclass(slots=True)
class ScanCounts:
    """Counts over scans.

    Attributes
    ----------
    confusion : Confusion
        Counts of all points.
    rings : tuple of Confusion
        Counts by distance, one per name in `RING_NAMES`; empty if not requested.
    unknown_truth, unknown_predictions : Counter
        Number of points by raw id that the label space does not know.
    scans : int
        Number of scans counted.
    missing : list of ScanFile
        Scans without predictions.
    files : Counter of str
        Number of scans that have probabilities or a kind of uncertainty, by folder.
    confidence : dict of str to ConfidenceHistogram
        Histograms by grouping: `CLASS`, the most probable one, or `RING`.
    calibration_errors : list of float
        Expected calibration error of each scan that has a softmax.
    uncertainty : dict of (str, str) to UncertaintyHistogram
        Histograms by kind of uncertainty and grouping: `CLASS`, the true one, or `RING`.
    """

    confusion: Confusion
    rings: tuple[Confusion, ...] = ()
    unknown_truth: Counter[int] = field(default_factory=Counter)
    unknown_predictions: Counter[int] = field(default_factory=Counter)
    scans: int = 0
    missing: list[ScanFile] = field(default_factory=list)
    files: Counter[str] = field(default_factory=Counter)
    confidence: dict[str, ConfidenceHistogram] = field(default_factory=dict)
    calibration_errors: list[float] = field(default_factory=list)
    uncertainty: dict[tuple[str, str], UncertaintyHistogram] = field(default_factory=dict)

    @classmethod
    def none(cls, space: LabelSpace, by_distance: bool) -> ScanCounts:
        """Return the counts of no scan at all."""
        rings = tuple(Confusion(space.class_count) for _ in RING_NAMES)
        return cls(Confusion(space.class_count), rings if by_distance else ())

    def add(self, other: ScanCounts) -> None:
        """Add the counts of other scans, which are used up."""
        self.confusion += other.confusion
        self.rings = tuple(a + b for a, b in zip(self.rings, other.rings, strict=True))
        self.unknown_truth += other.unknown_truth
        self.unknown_predictions += other.unknown_predictions
        self.scans += other.scans
        self.missing += other.missing
        self.files += other.files
        self.calibration_errors += other.calibration_errors
        _add_histograms(self.confidence, other.confidence)
        _add_histograms(self.uncertainty, other.uncertainty)


def _add_histograms(total: dict[Key, Histogram], other: Mapping[Key, Histogram]) -> None:
    for key, histogram in other.items():
        if total.setdefault(key, histogram) is not histogram:
            total[key].add(histogram)


def count_scan(
    scan: ScanFile, out: Path, space: LabelSpace, by_distance: bool = False
) -> ScanCounts:
    """Count one scan; one without predictions counts as missing.

    Points whose truth is scored are counted by probability and by uncertainty too, if the output
    folder holds `probabilities/` and `uncertainty/` of the scan.

    Parameters
    ----------
    scan : ScanFile
        Its labels lie where `ScanFile.label_path` says.
    out : Path
        Output folder with the predictions.
    space : LabelSpace
        Meaning of the raw ids in both.
    by_distance : bool
        Count rings of distance too, for which the scan is read.

    Raises
    ------
    FormatError, LabelError
        If a file cannot be read, is not of this scan, or holds impossible values.
    """
    counts = ScanCounts.none(space, by_distance)
    predictions = output_path(out, scan.sequence, "predictions", scan.stem)
    if not present(predictions):
        counts.missing.append(scan)
        return counts
    points = read_scan(scan.path).points if by_distance else None
    raw_truth = read_labels(scan.label_path, None if points is None else len(points))
    raw_predicted = read_labels(predictions, len(raw_truth))
    truth = space.to_train(raw_truth, strict=False)
    predicted = space.to_train(raw_predicted, strict=False)
    counts.scans = 1
    counts.unknown_truth.update(space.unknown_ids(raw_truth))
    counts.unknown_predictions.update(space.unknown_ids(raw_predicted))
    counts.confusion.update(truth, predicted)
    scored = space.scored[truth]
    rings: Groups = {}
    if points is not None:
        ring = ring_of_point(points)
        counts.rings = tuple(
            Confusion(space.class_count).update(truth[ring == i], predicted[ring == i])
            for i in range(len(RING_NAMES))
        )
        rings = {RING: (np.where(ring < 0, NO_RING, ring)[scored], NO_RING + 1)}
    paths = {f: output_path(out, scan.sequence, f, scan.stem) for f in FOLDERS}
    paths = {folder: path for folder, path in paths.items() if present(path)}
    counts.files.update(paths.keys())
    values: dict[str, Float] = {}
    if path := paths.pop("probabilities", None):
        softmax = read_probabilities(path, len(scored), space.class_count)[scored]
        if not space.scored[0]:
            # `predict` marks points without a pixel as certainly unlabelled; no softmax is that.
            softmax[softmax[:, 0] == 1] = np.nan
        _count_confidence(counts, softmax_errors(softmax, truth[scored]), rings, space)
        values = {kind: derive(softmax) for kind, derive in OF_SOFTMAX.items()}
    for folder, path in paths.items():
        values[folder.removeprefix(UNCERTAINTY)] = read_uncertainty(path, len(scored))[scored]
    groups = {CLASS: (truth[scored], space.class_count), **rings}
    wrong = (predicted != truth)[scored]
    for kind, of_points in values.items():
        for name, (group, group_count) in groups.items():
            histogram = UncertaintyHistogram(group_count).update(of_points, wrong, group)
            counts.uncertainty[kind, name] = histogram
    return counts


def _count_confidence(
    counts: ScanCounts, errors: SoftmaxErrors, rings: Groups, space: LabelSpace
) -> None:
    groups = {CLASS: (errors.predicted, space.class_count), **rings}
    for name, (group, group_count) in groups.items():
        counts.confidence[name] = ConfidenceHistogram(group_count).update(errors, group)
    of_scan = counts.confidence[CLASS].total()
    if of_scan.points[0]:
        counts.calibration_errors.append(reliability(of_scan.counts[:, 0], SCAN_BINS).error)
