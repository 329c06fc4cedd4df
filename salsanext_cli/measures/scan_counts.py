# SPDX-License-Identifier: MIT
"""Counts of how the predictions for scans compare with their labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.point_values import read_probabilities, read_uncertainty
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.calibration import ConfidenceHistogram, SoftmaxErrors, softmax_errors
from salsanext_cli.measures.confusion import Confusion, Mask
from salsanext_cli.measures.distance import RING_NAMES, confusion_by_ring, ring_of_point
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
"""Names of what points are grouped by."""
NO_RING = len(RING_NAMES)
"""The group of points without a measurement."""

Key = TypeVar("Key")
Histogram = TypeVar("Histogram", bound=GroupedHistogram)
Groups = dict[str, tuple[npt.NDArray[Any], int]]
"""The group of every point and the number of groups, by what the points are grouped by."""


@dataclass(slots=True)
class ScanCounts:
    """Counts over scans.

    Attributes
    ----------
    confusion : Confusion
        Counts of all points.
    rings : tuple of Confusion
        Counts by distance, one per name in `RING_NAMES`; empty if not wanted.
    unknown_truth, unknown_predictions : Counter
        How often raw ids occur that the label space does not know.
    scans : int
        Number of scans counted.
    missing : list of ScanFile
        Scans without predictions.
    files : Counter of str
        Number of scans that have probabilities or a kind of uncertainty, by folder.
    confidence : dict of str to ConfidenceHistogram
        By what the points are grouped by: `CLASS`, the most probable one, or `RING`.
    calibration_errors : list of float
        Expected calibration error of each scan that has a softmax.
    uncertainty : dict of (str, str) to UncertaintyHistogram
        By kind of uncertainty and by what the points are grouped by: `CLASS`, the true one, or
        `RING`.
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
        """Add the counts of other scans."""
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
        if key not in total:
            total[key] = type(histogram)(histogram.group_count)
        total[key].add(histogram)


def count_scan(
    scan: ScanFile, out: Path, space: LabelSpace, by_distance: bool = False
) -> ScanCounts:
    """Count one scan; one without predictions counts as missing.

    Points are counted by probability and by uncertainty too, as far as the output folder holds
    `probabilities/` and `uncertainty/` of the scan, if their truth is scored.

    Parameters
    ----------
    scan : ScanFile
        Its labels lie where `ScanFile.label_path` says.
    out : Path
        Output folder with the predictions.
    space : LabelSpace
        What the raw ids in both mean.
    by_distance : bool
        Count rings of distance too, for which the scan is read.

    Raises
    ------
    FormatError, LabelError
        If a file cannot be read, is not of this scan, or holds what it cannot mean.
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
    ring = None
    if points is not None:
        ring = ring_of_point(points)
        counts.rings = confusion_by_ring(ring, truth, predicted, space.class_count)
    _count_uncertainty(counts, scan, out, space, truth, predicted, ring)
    return counts


def _count_uncertainty(
    counts: ScanCounts,
    scan: ScanFile,
    out: Path,
    space: LabelSpace,
    truth: TrainIds,
    predicted: TrainIds,
    ring: npt.NDArray[np.intp] | None,
) -> None:
    """Count the points of a scan whose truth is scored, by whatever lies in the output folder."""
    paths = {f: output_path(out, scan.sequence, f, scan.stem) for f in FOLDERS}
    paths = {folder: path for folder, path in paths.items() if present(path)}
    counts.files.update(paths.keys())
    scored = space.scored[truth]
    rings: Groups = {}
    if ring is not None:
        rings = {RING: (np.where(ring < 0, NO_RING, ring)[scored], NO_RING + 1)}
    values: dict[str, Float] = {}
    if path := paths.pop("probabilities", None):
        softmax = _read_softmax(path, scored, space)
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


def _read_softmax(path: Path, scored: Mask, space: LabelSpace) -> npt.NDArray[np.float16]:
    """Read the probabilities of the points whose truth is scored; NaN for those without a pixel."""
    softmax = read_probabilities(path, len(scored), space.class_count)[scored]
    if not space.scored[0]:
        # `predict` marks them as certainly unlabelled, which no softmax says.
        softmax[softmax[:, 0] == 1] = np.nan
    return softmax


def _count_confidence(
    counts: ScanCounts, errors: SoftmaxErrors, rings: Groups, space: LabelSpace
) -> None:
    groups = {CLASS: (errors.predicted, space.class_count), **rings}
    for name, (group, group_count) in groups.items():
        counts.confidence[name] = ConfidenceHistogram(group_count).update(errors, group)
    of_scan = counts.confidence[CLASS].total()
    if of_scan.points[0]:
        counts.calibration_errors.append(reliability(of_scan.counts[:, 0], SCAN_BINS).error)
