# SPDX-License-Identifier: MIT
"""Confusion matrix of a page, in texts; a script shows the points of a cell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.scores import Counts, largest_confusions, scored_rows
from salsanext_cli.core.texts import counted
from salsanext_cli.report.page.scan_row import ScanRow
from salsanext_cli.report.tables import percent

MAX_CONFUSIONS = 10
LEAST_SHOWN = 0.005  # Shares below this have no number


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """Points of a true class that have one label."""

    key: str  # Train ids of truth and label, "9,11"
    outcome: str  # "right" or "wrong"
    share: float  # Of the points of the true class, 0…1
    number: str  # The share in percent; empty if it is small
    title: str


@dataclass(frozen=True, slots=True, kw_only=True)
class MatrixRow:
    """Points of a true class by label."""

    name: str
    cells: Sequence[Cell | None]  # By label; None without points
    points: str  # Number of points of the class


@dataclass(frozen=True, slots=True, kw_only=True)
class ConfusionMatrix:
    """Points by true class and label; only classes that occur."""

    labels: Sequence[str]  # Names of the predicted classes
    rows: Sequence[MatrixRow]


def largest_confusions_in_words(confusion: Counts, space: LabelSpace) -> list[str]:
    """Return the most frequent confusions of a matrix (C, C) in words, the largest first."""
    matrix = scored_rows(confusion, space)
    names = space.names
    truths = matrix.sum(axis=1).tolist()
    return [
        f"{names[c.true]} taken for {names[c.predicted]}: "
        f"{percent(c.points / truths[c.true], 1, ' %')} of {counted(truths[c.true], 'point')}"
        for c in largest_confusions(matrix, MAX_CONFUSIONS)
    ]


def confusion_matrix(confusion: Counts, space: LabelSpace) -> ConfusionMatrix | None:
    """Return the texts of a confusion matrix (C, C); None without points.

    A row has the points of a true class; cells are shares of these points.
    """
    matrix = scored_rows(confusion, space)
    true = np.flatnonzero(matrix.sum(axis=1)).tolist()
    if not true:
        return None
    predicted = np.flatnonzero(matrix.sum(axis=0)).tolist()
    rows = [
        MatrixRow(
            name=space.names[i],
            cells=[_cell(i, j, matrix[i], space) for j in predicted],
            points=f"{int(matrix[i].sum()):,}",
        )
        for i in true
    ]
    return ConfusionMatrix(labels=[space.names[j] for j in predicted], rows=rows)


def _cell(true: int, predicted: int, row: Counts, space: LabelSpace) -> Cell | None:
    """Return a cell of the row of a true class, points (C,) by label; None without points."""
    points = int(row[predicted])
    if not points:
        return None
    total = int(row.sum())
    share = points / total
    is_right = true == predicted
    taken = "" if is_right else f" taken for {space.names[predicted]}"
    return Cell(
        key=f"{true},{predicted}",
        outcome="right" if is_right else "wrong",
        share=share,
        number=f"{100 * share:.0f}" if share >= LEAST_SHOWN else "",
        title=f"{space.names[true]}{taken}: {points:,} of {counted(total, 'point')}",
    )


def cells_of(rows: Sequence[ScanRow], openable: Sequence[str]) -> dict[str, list[object]]:
    """Return, for each cell of the matrix, the scans with most of its points.

    Parameters
    ----------
    rows : sequence of ScanRow
        All scans.
    openable : sequence of str
        Names of the scans that the page can show.

    Returns
    -------
    dict of str to list
        By train ids of truth and label, ``"9,11"``: number in `openable` of the scan with most
        points, -1 if none of them has any, and name of the scan with most points of all.
    """
    number_of = {name: number for number, name in enumerate(openable)}
    most = _with_most(rows)
    openable_rows = _with_most([row for row in rows if row.file.name in number_of])
    scans: dict[str, list[object]] = {}
    for cell, row in sorted(most.items()):
        true, label = cell
        number = number_of[openable_rows[cell].file.name] if cell in openable_rows else -1
        scans[f"{true},{label}"] = [number, row.file.name]
    return scans


def _with_most(rows: Sequence[ScanRow]) -> dict[tuple[int, int], ScanRow]:
    """Return the first scan with most points of each cell, by train ids of truth and label."""
    best: dict[tuple[int, int], ScanRow] = {}
    for row in rows:
        for true, label in np.argwhere(row.confusion).tolist():
            cell = (true, label)
            if cell not in best or row.confusion[cell] > best[cell].confusion[cell]:
                best[cell] = row
    return best
