# SPDX-License-Identifier: MIT
"""Labels of the points of a scan from the files that a labelling tool wrote."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace, RawIds
from salsanext_cli.errors import LabelError, counted, first_few
from salsanext_cli.formats.label_scalars import (
    READERS,
    LabelIds,
    LabelledCloud,
    read_labelled_cloud,
    whole_numbers,
)
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.formats.npy import read_integers
from salsanext_cli.geometry.label_transfer import (
    TOLERANCE_M,
    LabelTransfer,
    merged_transfers,
    transfer_labels,
)
from salsanext_cli.records import Float

MAX_UNMATCHED = 0.01
"""Largest share of the points of a cloud that may be none of the scan's."""
ROUNDED_M = 0.05
"""Distance up to which coordinates were probably rounded; other scans are farther away."""
LABELS_ONLY = "labels"
"""Stands for the scalar of files that hold nothing else."""


class UnknownIds(LabelError):  # noqa: N818 - the name says what is wrong
    """Ids of a file that mean nothing; `points` has their numbers of points."""

    def __init__(self, subject: object, points: Counter[int], meanings: LabelIds) -> None:
        listed = ", ".join(f"{i} ({counted(n, 'point')})" for i, n in sorted(points.items()))
        super().__init__(
            subject,
            f"unknown label ids {listed}",
            meanings.described(),
            "map a tool's own ids with --map",
        )
        self.points = points


@dataclass(frozen=True, slots=True)
class EditedLabels:
    """Labels of the points of a scan."""

    raw: RawIds  # (N,) uint32: raw ids, with instances; the unlabelled one where there is no label
    labelled: int  # Number of points of a class that counts
    unlabelled: int  # Number of points that were left unlabelled, or given another ignored class
    # Number of points with several labels, and of those that the files lack; together the four
    # numbers are N
    ambiguous: int
    missing: int
    unmatched: int  # Number of points of the files that are none of the scan's
    contradicted: int  # Number of ambiguous points that each file has one label of
    scalar: str  # Scalar that held the labels, or several

    def numbers(self) -> dict[str, int | str]:
        """Return all but the labels, as records and JSON have it."""
        return {each.name: getattr(self, each.name) for each in fields(self) if each.name != "raw"}


@dataclass(frozen=True, slots=True)
class FileLabels:
    """Labels of the points of a scan in one file, and the name of the scalar that holds them."""

    found: LabelTransfer
    scalar: str


def read_file_labels(
    path: Path, points: Float, meanings: LabelIds, scalar: str | None = None
) -> FileLabels:
    """Read the labels that a tool wrote for points (N, 3), matched by place or by order."""
    has_points = path.suffix.lower() in READERS
    cloud = read_labelled_cloud(path, scalar) if has_points else _of_all_points(path, points)
    if unknown := meanings.unknown(cloud.ids):
        raise UnknownIds(path, Counter(unknown), meanings)
    raw, every = meanings.to_raw(cloud.ids), np.ones(len(points), bool)
    if not has_points:
        transfer = LabelTransfer(raw, every, ~every, every, np.empty(0), len(points))
        return FileLabels(transfer, cloud.scalar)
    transfer = transfer_labels(points, cloud.points, raw)
    _require_same_scan(path, transfer)
    return FileLabels(transfer, cloud.scalar)


def edited_labels(
    parts: Mapping[Path, FileLabels], space: LabelSpace, unlabelled: int
) -> EditedLabels:
    """Return the labels that files hold of a scan; points without one get the unlabelled raw id."""
    found = merged_transfers([part.found for part in parts.values()], unlabelled)
    alone = np.any([part.found.ambiguous for part in parts.values()], axis=0)
    scalar = ", ".join(sorted({part.scalar for part in parts.values()}))
    raw = found.filled(unlabelled)
    labelled = int(space.scored[space.to_train(raw, strict=False)].sum())
    if not labelled:
        text = f"{scalar}: none of the {counted(len(raw), 'point')} has a class that counts"
        remedy = "label some, or name the scalar with --scalar"
        raise LabelError(first_few([*parts]), text, "at least one", remedy)
    return EditedLabels(
        raw,
        labelled,
        int(found.known.sum()) - labelled,
        int(found.ambiguous.sum()),
        int(found.missing.sum()),
        len(found.unmatched),
        int((found.ambiguous & ~alone).sum()),
        scalar,
    )


def _of_all_points(path: Path, points: Float) -> LabelledCloud:
    """Read a file of labels only, one for each point in order."""
    if path.suffix.lower() == ".npy":
        values: npt.NDArray[np.integer] = read_integers(path)
        if len(values) != len(points):
            found, expected = counted(len(values), "label"), f"{len(points):,}, one per point"
            raise LabelError(path, found, f"{expected} of the scan", "use those of this scan")
    else:
        values = read_labels(path, len(points))
    return LabelledCloud(points, whole_numbers(values, path, "label"), LABELS_ONLY)


def _require_same_scan(path: Path, found: LabelTransfer) -> None:
    """Refuse a cloud of which too many points are none of the scan's."""
    count = len(found.unmatched)
    if count <= MAX_UNMATCHED * found.cloud_points:
        return
    distance = float(np.median(found.unmatched))
    cause = "it is of another scan, or its coordinates were shifted, turned or scaled"
    if distance < ROUNDED_M:
        cause = "its coordinates were rounded or moved: save it with more digits"
    raise LabelError(
        path,
        f"{count:,} of its {found.cloud_points:,} points are none of the scan's, but "
        f"{distance:.3g} m from the nearest (median)",
        f"all within {1000 * TOLERANCE_M:g} mm of one",
        cause,
    )
