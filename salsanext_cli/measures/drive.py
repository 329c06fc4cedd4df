# SPDX-License-Identifier: MIT
"""Scans of a drive in a few numbers each, and the choice of those worth looking at."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.classes.merging import ClassMerging
from salsanext_cli.errors import UsageError, first_few
from salsanext_cli.files.reading import present
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.measures.confusion import Confusion, Counts
from salsanext_cli.measures.scan_counts import ScanCounts, count_scan
from salsanext_cli.measures.scores import scores
from salsanext_cli.results.layout import UNCERTAINTY, ScanFile, output_path
from salsanext_cli.results.result_folder import read_kind
from salsanext_cli.sensors.sensor import Sensor

LEADING_KINDS = ("error", "entropy", *UNCERTAINTY)
"""Kinds of uncertainty by how well they tell which scan is uncertain; the first one known counts.
"""


@dataclass(frozen=True, slots=True, eq=False)
class ScanRow:
    """One scan of a drive in numbers."""

    file: ScanFile
    points: int  # Number of its points that have a label or an uncertainty
    class_points: Counts | None  # (C,) int64 or None: number of points by predicted train id
    uncertainty: Mapping[str, float]  # Mean over the points by kind; NaN without any
    # (C, C) int64 or None: points by truth and prediction, as `Confusion.counted`; None without
    # labels
    confusion: Counts | None = None

    @property
    def name(self) -> str:
        """Sequence and stem."""
        return f"{self.file.sequence}/{self.file.stem}"

    @property
    def wrong(self) -> float:
        """Share of the labelled points that is wrong, 0…1; NaN without any."""
        if self.confusion is None or not self.confusion.any():
            return math.nan
        return float(1 - self.confusion.trace() / self.confusion.sum())


def read_row(
    file: ScanFile,
    out: Path,
    space: LabelSpace,
    labels: LabelSpace,
    merging: ClassMerging | None,
    sensor: Sensor,
    by_distance: bool = False,
    trained_on: Collection[str] = (),
) -> tuple[ScanRow, ScanCounts | None]:
    """Read the results of a scan, and compare them with its labels.

    `file`, `out`, `space`, `labels`, `merging`, `sensor`, `by_distance`, `trained_on`: as for
    `count_scan`.

    The counts are None without labels or without predictions.
    """
    path_of = partial(output_path, out, file.sequence, stem=file.stem)
    class_points, points = None, 0
    if present(path := path_of(folder="predictions")):
        predicted = space.to_train(read_labels(path), strict=False, source=path)
        points = len(predicted)
        class_points = np.bincount(predicted, minlength=space.class_count)
    uncertainty = {}
    for kind in UNCERTAINTY:
        if present(path := path_of(folder=f"uncertainty/{kind}")):
            values = read_kind(path, kind, points or None)
            points = len(values)
            finite = values[np.isfinite(values)]
            uncertainty[kind] = float(finite.mean(dtype=np.float64)) if len(finite) else math.nan
    if class_points is None or not present(file.label_path):
        return ScanRow(file, points, class_points, uncertainty), None
    counts = count_scan(file, out, space, by_distance, sensor, labels, merging, trained_on)
    confusion = counts.confusion.counted(space.scored)
    return ScanRow(file, points, class_points, uncertainty, confusion), counts


def leading_kind(rows: Sequence[ScanRow]) -> str | None:
    """Return the first of `LEADING_KINDS` that is known of some scan, None without any."""
    return next((kind for kind in LEADING_KINDS if any(kind in r.uncertainty for r in rows)), None)


def worth_looking_at(rows: Sequence[ScanRow], space: LabelSpace) -> dict[str, str]:
    """Choose scans of a drive: most uncertain, most wrong, worst class, and one at random.

    `rows`: all scans, in their order; at least one; `space`: classes of the labels.

    Returns the reasons by the scan's name; one or two for each.
    """
    reasons: dict[str, list[str]] = {}
    if kind := leading_kind(rows):
        means = [row.uncertainty.get(kind, math.nan) for row in rows]
        words = f"most uncertain (mean {kind.replace('_', ' ')}"
        _take(reasons, rows, means, lambda mean: f"{words} {mean:.3g})")
    wrong = [row.wrong for row in rows]
    _take(reasons, rows, wrong, lambda share: f"most wrong ({100 * share:.1f} % of the points)")
    judged = [row.confusion for row in rows if row.confusion is not None]
    if judged:
        of_class = _worst_class(sum(judged[1:], judged[0]), space)
        if of_class is not None:
            missed = [_missed(row.confusion, of_class) for row in rows]
            name = space.names[of_class]
            _take(reasons, rows, missed, lambda n: f"worst class: {n:,.0f} points of {name} wrong")
    left = [row for row in rows if row.name not in reasons]
    if left:
        # The same for the same scans.
        reasons[random.Random(len(rows)).choice(left).name] = ["at random"]
    return {name: ", ".join(given) for name, given in reasons.items()}


def _take(
    reasons: dict[str, list[str]],
    rows: Sequence[ScanRow],
    values: Sequence[float],
    reason: Callable[[float], str],
) -> None:
    """Add the scan of the largest value, if any value is above 0."""
    place = int(np.nan_to_num(values).argmax())
    if values[place] > 0:
        reasons.setdefault(rows[place].name, []).append(reason(values[place]))


def _worst_class(matrix: Counts, space: LabelSpace) -> int | None:
    """Return the class of the lowest IoU of those that the truth holds."""
    found = scores(Confusion(space.class_count, matrix), space).classes
    present_ones = [each for each in found if each.points]
    return min(present_ones, key=lambda each: each.iou).train_id if present_ones else None


def _missed(confusion: Counts | None, train_id: int) -> float:
    """Return the number of points of a class, or called so, that are wrong."""
    if confusion is None:
        return math.nan
    of_class = confusion[train_id].sum() + confusion[:, train_id].sum()
    return float(of_class - 2 * confusion[train_id, train_id])


def named(rows: Sequence[ScanRow], names: Sequence[str]) -> dict[str, str]:
    """Choose scans by name, ``08/000000``, or by stem where only one sequence has it."""
    chosen: dict[str, str] = {}
    for name in names:
        found = [row.name for row in rows if name in (row.name, row.file.stem)]
        if len(found) != 1:
            there = first_few([row.name for row in rows]) if not found else first_few(found)
            what = "no results of a scan of that name" if not found else f"{len(found)} scans"
            raise UsageError("--scans", f"{name}: {what}", f"names such as {there}")
        chosen[found[0]] = "named"
    return chosen
