# SPDX-License-Identifier: MIT
"""Count how the predictions for one scan compare with its labels."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path

from salsanext_cli.classes import LabelSpace
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.distance import RING_NAMES, confusion_by_ring, ring_of_point
from salsanext_cli.measures.uncertainty_counts import UncertaintyCounts, count_uncertainty
from salsanext_cli.storage.layout import ScanFile, output_path


@dataclass(frozen=True, slots=True)
class ScanCounts:
    """What counting gives; adding two gives the counts of both.

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
    missing : tuple of ScanFile
        Scans without predictions.
    uncertainty : UncertaintyCounts
        Counts by probability and by uncertainty, of the scans that have such files.
    """

    confusion: Confusion
    rings: tuple[Confusion, ...] = ()
    unknown_truth: Counter[int] = field(default_factory=Counter)
    unknown_predictions: Counter[int] = field(default_factory=Counter)
    scans: int = 0
    missing: tuple[ScanFile, ...] = ()
    uncertainty: UncertaintyCounts = field(default_factory=UncertaintyCounts)

    @classmethod
    def none(cls, space: LabelSpace, by_distance: bool) -> ScanCounts:
        """Return the counts of no scan at all."""
        rings = tuple(Confusion(space.class_count) for _ in RING_NAMES)
        return cls(Confusion(space.class_count), rings if by_distance else ())

    def __add__(self, other: ScanCounts) -> ScanCounts:
        return ScanCounts(
            self.confusion + other.confusion,
            tuple(a + b for a, b in zip(self.rings, other.rings, strict=True)),
            self.unknown_truth + other.unknown_truth,
            self.unknown_predictions + other.unknown_predictions,
            self.scans + other.scans,
            self.missing + other.missing,
            self.uncertainty + other.uncertainty,
        )


def count_scan(
    scan: ScanFile, out: Path, space: LabelSpace, by_distance: bool = False
) -> ScanCounts:
    """Count one scan; one without predictions counts as missing.

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
        If a file cannot be read, or the numbers of points differ.
    """
    predictions = output_path(out, scan.sequence, "predictions", scan.stem)
    if not present(predictions):
        return replace(ScanCounts.none(space, by_distance), missing=(scan,))
    points = read_scan(scan.path).points if by_distance else None
    truth = read_labels(scan.label_path, None if points is None else len(points))
    predicted = read_labels(predictions, len(truth))
    ids = space.to_train(truth, strict=False), space.to_train(predicted, strict=False)
    ring = None if points is None else ring_of_point(points)
    return ScanCounts(
        Confusion(space.class_count).update(*ids),
        () if ring is None else confusion_by_ring(ring, *ids, space.class_count),
        Counter(space.unknown_ids(truth)),
        Counter(space.unknown_ids(predicted)),
        scans=1,
        uncertainty=count_uncertainty(scan, out, space, *ids, ring),
    )
