# SPDX-License-Identifier: MIT
"""Tables for a terminal: columns of numbers, and the scores of an evaluation."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from salsanext_cli.measures.scores import Scores
from salsanext_cli.measures.uncertainty_evaluation import (
    CalibrationResult,
    RankingResult,
    UncertaintyEvaluation,
)

if TYPE_CHECKING:
    from rich.table import Table

ABSENT = "–"


def percent(share: float, digits: int = 1, unit: str = "") -> str:
    """Return a share as a number of percent; "–" for NaN."""
    return ABSENT if math.isnan(share) else f"{100 * share:.{digits}f}{unit}"


def number_table(first: str, *numbers: str, title: str = "", no_wrap: bool = False) -> Table:
    """Return an empty table: a column of names, which may be kept on one line, then numbers."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title) or None, title_justify="left")
    table.add_column(first, no_wrap=no_wrap)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


def score_table(result: Scores) -> Table:
    """Return a table of every class, then the accuracy and the means.

    Parameters
    ----------
    result : Scores
        Scores to show.

    Returns
    -------
    rich.table.Table
        Class, IoU %, precision %, recall %, points; "–" where a class is absent.
    """
    from rich.markup import escape

    table = number_table("class", "IoU %", "precision %", "recall %", "points", no_wrap=True)
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


def ring_table(rings: Mapping[str, Scores]) -> Table:
    """Return a table with a row per ring of distance: mean IoU of the classes present, accuracy."""
    table = number_table("distance", "mean IoU %", "accuracy %", "points")
    for name, result in rings.items():
        shares = (percent(share) for share in (result.iou_mean_present, result.accuracy))
        table.add_row(name, *shares, f"{result.points:,}")
    return table


def uncertainty_tables(evaluation: UncertaintyEvaluation) -> list[Table]:
    """Return a table of the calibration and one of the kinds of uncertainty; none without any."""
    tables = [_calibration_table(evaluation.calibration)] if evaluation.calibration else []
    return [*tables, _ranking_table(evaluation.kinds)] if evaluation.kinds else tables


def _calibration_table(result: CalibrationResult) -> Table:
    """Return a table of one row: log-likelihood, Brier score and calibration errors."""
    errors = ("ECE %", "ECE per scan %", "ACE %")
    headings = ("calibration", "NLL, nats", "Brier", *errors, "scans", "points")
    table = number_table(*headings, no_wrap=True)
    scores = result.scores
    table.add_row(
        *("softmax", _number(scores.nll), _number(scores.brier)),
        *(percent(error, 2) for error in (scores.ece, result.ece_per_scan, scores.ace)),
        *(f"{result.scans:,}", f"{scores.points:,}"),
    )
    return table


def _ranking_table(kinds: Mapping[str, RankingResult]) -> Table:
    """Return a table with a row of scores per kind of uncertainty."""
    columns = ("AUROC %", "AUPR %", "AURC %", "AUSE", "wrong %", "scans", "points")
    table = number_table("uncertainty", *columns, no_wrap=True)
    for kind, result in kinds.items():
        scores = result.scores
        wrong = scores.wrong / scores.points if scores.points else math.nan
        table.add_row(
            *(kind, percent(scores.auroc, 1), percent(scores.aupr, 1), percent(scores.aurc, 2)),
            *(_number(scores.ause), percent(wrong, 1), f"{result.scans:,}", f"{scores.points:,}"),
        )
    return table


def _number(value: float) -> str:
    return ABSENT if math.isnan(value) else f"{value:.3f}"
