# SPDX-License-Identifier: MIT
"""Tables of how far probabilities and uncertainties can be trusted."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

from salsanext_cli.measures.figures import CalibrationFigures, UncertaintyFigures
from salsanext_cli.report.numbers import ABSENT, percent

if TYPE_CHECKING:
    from rich.table import Table


def trust_tables(
    calibration: CalibrationFigures | None, uncertainty: Mapping[str, UncertaintyFigures]
) -> list[Table]:
    """Return a table of the calibration and one of the kinds of uncertainty; none without any."""
    tables = [calibration_table(calibration)] if calibration else []
    return [*tables, uncertainty_table(uncertainty)] if uncertainty else tables


def calibration_table(figures: CalibrationFigures) -> Table:
    """Return a table of one row: log-likelihood, Brier score and calibration errors."""
    scores = figures.scores
    table = _table(
        "calibration", "NLL, nats", "Brier", "ECE %", "ECE per scan %", "ACE %", "scans", "points"
    )
    errors = (percent(error, 2) for error in (scores.ece, figures.scan_error, scores.ace))
    table.add_row(
        "softmax",
        _number(scores.nll),
        _number(scores.brier),
        *errors,
        f"{figures.scans:,}",
        f"{scores.points:,}",
    )
    return table


def uncertainty_table(kinds: Mapping[str, UncertaintyFigures]) -> Table:
    """Return a table with a row per kind of uncertainty: how well it finds wrong points."""
    table = _table(
        "uncertainty", "AUROC %", "AUPR %", "AURC %", "AUSE", "wrong %", "scans", "points"
    )
    for kind, figures in kinds.items():
        scores = figures.scores
        wrong = scores.wrong / scores.points if scores.points else math.nan
        table.add_row(
            kind,
            percent(scores.auroc, 1),
            percent(scores.aupr, 1),
            percent(scores.aurc, 2),
            _number(scores.ause),
            percent(wrong, 1),
            f"{figures.scans:,}",
            f"{scores.points:,}",
        )
    return table


def _table(first: str, *headings: str) -> Table:
    from rich.table import Table

    table = Table()
    table.add_column(first, no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right")
    return table


def _number(value: float) -> str:
    return ABSENT if math.isnan(value) else f"{value:.3f}"
