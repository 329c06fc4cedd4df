# SPDX-License-Identifier: MIT
"""Tables of `tune`: scores before and after a fit, on held-out scans."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Group
from rich.table import Table
from rich.text import Text

from salsanext_cli.core.texts import counted
from salsanext_cli.report.tables import accepted_table, needed_scans_table, percent, table_of

if TYPE_CHECKING:
    # They import torch, which takes a second; a refused command needs none of it.
    from salsanext_cli.training.tuning.error import HeldOutScores
    from salsanext_cli.training.tuning.risk_report import RiskFit
    from salsanext_cli.training.tuning.temperature import TemperatureFit


def temperature_table(fit: TemperatureFit) -> Table:
    """Return a table of the temperature and its scores before and after the fit."""
    rows = [
        (name, f"{scores.temperature:.4f}", f"{scores.nll:.4f}", percent(scores.ece, 2))
        for name, scores in (("before", fit.before), ("after", fit.after))
    ]
    headings = ("", "temperature", "NLL in nats", "ECE in %")
    return table_of(headings, rows, title=f"Held-out scans, {counted(fit.folds, 'fold')}")


def error_table(held_out: HeldOutScores) -> Table:
    """Return a table of the scores of confidence, existing model and new model."""
    models = {
        "confidence": held_out.confidence,
        "existing model": held_out.existing,
        "new model": held_out.error,
    }
    rows = [
        (
            name,
            f"{scores.auroc:.4f}",
            f"{scores.aurc:.4f}",
            f"{scores.nll:.4f}",
            percent(scores.ece),
            percent(scores.risk_80),
        )
        for name, scores in models.items()
        if scores
    ]
    headings = ("", "AUROC", "AURC", "NLL", "ECE in %", "wrong of the best 80 %, in %")
    return table_of(headings, rows, title=f"Held-out scans, {counted(held_out.folds, 'fold')}")


def risk_tables(fit: RiskFit) -> Group:
    """Return tables of the accepted labels and of the least numbers of scans, with sentences."""
    level = fit.threshold
    sentences = Group(*map(Text, fit.sentences))
    classes = accepted_table(fit.accepted.classes)
    return Group(classes, needed_scans_table(level.at_most, level.confidence), sentences)
