# SPDX-License-Identifier: MIT
"""Scores as tables for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from salsanext_cli.measures.scores import Scores
from salsanext_cli.report.numbers import percent

if TYPE_CHECKING:
    from rich.table import Table


def score_table(result: Scores) -> Table:
    """Return a table of every class, then the accuracy and the means.

    Parameters
    ----------
    result : Scores
        What to show.

    Returns
    -------
    rich.table.Table
        Class, IoU %, precision %, recall %, points; "–" where a class is absent.
    """
    from rich.markup import escape
    from rich.table import Table

    table = Table()
    table.add_column("class", no_wrap=True)
    for heading in ("IoU %", "precision %", "recall %", "points"):
        table.add_column(heading, justify="right")
    for c in result.classes:
        shares = (percent(share) for share in (c.iou, c.precision, c.recall))
        table.add_row(escape(c.name), *shares, f"{c.points:,}")
    table.add_section()
    table.add_row("accuracy", percent(result.accuracy), "", "", f"{result.points:,}")
    table.add_row("accuracy, official", percent(result.accuracy_official))
    table.add_row("mean IoU, official", percent(result.iou_mean_official))
    present = sum(c.present for c in result.classes)
    table.add_row(f"mean IoU, {present} classes present", percent(result.iou_mean_present))
    return table


def ring_table(rings: dict[str, Scores]) -> Table:
    """Return a table with a row per ring of distance: mean IoU of the classes present, accuracy."""
    from rich.table import Table

    table = Table()
    table.add_column("distance")
    for heading in ("mean IoU %", "accuracy %", "points"):
        table.add_column(heading, justify="right")
    for name, result in rings.items():
        shares = (percent(share) for share in (result.iou_mean_present, result.accuracy))
        table.add_row(name, *shares, f"{result.points:,}")
    return table
