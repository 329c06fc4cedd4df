# SPDX-License-Identifier: MIT
"""Confusion matrix of a page; a script shows the points of a cell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import counted
from salsanext_cli.core.measures.scores import Counts, largest_confusions, scored_rows
from salsanext_cli.report.page.elements import listed, text_of
from salsanext_cli.report.page.scan_row import ScanRow
from salsanext_cli.report.tables import percent

MAX_CONFUSIONS = 10
LEAST_SHOWN = 0.005  # Shares below this have no number


def confusion_list(confusion: Counts, space: LabelSpace) -> str:
    """Return the most frequent confusions in words, as HTML."""
    matrix = scored_rows(confusion, space)
    names = space.names
    truths = matrix.sum(axis=1).tolist()
    lines = [
        f"{names[true]} taken for {names[predicted]}: "
        f"{percent(points / truths[true], 1, ' %')} of {counted(truths[true], 'point')}"
        for true, predicted, points in largest_confusions(matrix, MAX_CONFUSIONS)
    ]
    return listed("Largest confusions", '<ol class="confusions">', "</ol>", lines)


def confusion_table(confusion: Counts, space: LabelSpace) -> str:
    """Return the confusion matrix (C, C) as an HTML table with a button for each cell.

    A row has the points of a true class; cells are shares of these points.
    """
    matrix = scored_rows(confusion, space)
    true = np.flatnonzero(matrix.sum(axis=1)).tolist()
    if not true:
        return ""
    predicted = np.flatnonzero(matrix.sum(axis=0)).tolist()
    heads = "".join(f"<th scope=col><span>{text_of(space.names[j])}</span></th>" for j in predicted)
    rows = []
    for i in true:
        total = int(matrix[i].sum())
        cells = "".join(_cell(i, j, int(matrix[i, j]), total, space) for j in predicted)
        name = text_of(space.names[i])
        rows.append(f"<tr><th scope=row>{name}</th>{cells}<td>{total:,}</td></tr>")
    head = f"<tr><th>truth \\ label</th>{heads}<th scope=col>points</th></tr>"
    hint = (
        "Each row has the points of a true class, in % of them. Click a cell to see its points in "
        "the scan that has most of them."
    )
    table = f'<table id="confusion">{head}{"".join(rows)}</table>'
    start = f'<h3>Confusion matrix</h3><p class="hint">{hint}</p>'
    return f'{start}<div class="wide">{table}</div><p id="cell" aria-live="polite"></p>'


def _cell(true: int, predicted: int, points: int, total: int, space: LabelSpace) -> str:
    """Return one cell: a button, shaded by its share, or nothing without points."""
    if not points:
        return "<td></td>"
    share = points / total
    kind = "right" if true == predicted else "wrong"
    taken = "" if true == predicted else f" taken for {space.names[predicted]}"
    title = f"{space.names[true]}{taken}: {points:,} of {counted(total, 'point')}"
    number = f"{100 * share:.0f}" if share >= LEAST_SHOWN else ""
    return (
        f'<td><button type="button" class="{kind}" data-cell="{true},{predicted}" '
        f'style="--share:{share:.3f}" title="{text_of(title)}" aria-label="{text_of(title)}">'
        f"{number}</button></td>"
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
    shown = _with_most([row for row in rows if row.file.name in number_of])
    scans: dict[str, list[object]] = {}
    for cell, row in sorted(most.items()):
        true, label = cell
        number = number_of[shown[cell].file.name] if cell in shown else -1
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
