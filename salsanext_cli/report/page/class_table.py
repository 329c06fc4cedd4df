# SPDX-License-Identifier: MIT
"""Table of the classes of a run: share of the points, and IoU on labelled scans."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.core.texts import counted
from salsanext_cli.report.colours import Colours
from salsanext_cli.report.page.run_results import Comparison
from salsanext_cli.report.tables import percent

SMALL_SHARE = 0.1  # Smaller shares have one more decimal


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassRow:
    """One class, its share of the points, and its IoU."""

    name: str
    colour: Sequence[int]  # Red, green and blue, 0…255
    share: str  # Of all points
    share_of_largest: float  # Share divided by that of the largest class, 0…1
    iou: float | None  # 0…1; None for a class without labelled points
    iou_text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassTable:
    """All predicted or true classes, the largest first."""

    share_heading: str
    iou_heading: str  # Empty without labelled scans
    rows: Sequence[ClassRow]  # Empty if no stage has predicted labels


def class_table(
    points: Counts, compared: Comparison | None, space: LabelSpace, colours: Colours
) -> ClassTable:
    """Return the shares and IoUs of all predicted or true classes.

    Parameters
    ----------
    points : ndarray of int64 (C,)
        Number of points by predicted train id.
    compared : Comparison or None
        Comparison with labels; None without labels.
    space : LabelSpace
        The classes.
    colours : ndarray of uint8 (C, 3)
        Red, green and blue of each class.

    Returns
    -------
    ClassTable
    """
    total = int(points.sum())
    ious = {c.train_id: c.iou for c in compared.scores.classes if c.points} if compared else {}
    share_heading = f"share of all {counted(total, 'point')}"
    iou_heading = _iou_heading(compared) if compared and ious else ""
    if not total:
        return ClassTable(share_heading=share_heading, iou_heading=iou_heading, rows=())
    shares = points / total
    largest_first = np.argsort(-shares, kind="stable").tolist()
    rows = [
        ClassRow(
            name=space.names[i],
            colour=colours[i].tolist(),
            share=percent(shares[i], 2 if shares[i] < SMALL_SHARE else 1, " %"),
            share_of_largest=float(shares[i] / shares.max()),
            iou=ious.get(i),
            iou_text=percent(ious.get(i, math.nan), 1, " %"),
        )
        for i in largest_first
        if points[i] or i in ious
    ]
    return ClassTable(share_heading=share_heading, iou_heading=iou_heading, rows=rows)


def _iou_heading(compared: Comparison) -> str:
    """Return the heading of the column of IoUs, with the number of points behind them."""
    judged = "accepted" if compared.accepted else "labelled"
    return f"IoU of {counted(compared.scores.points, f'{judged} point')}"
