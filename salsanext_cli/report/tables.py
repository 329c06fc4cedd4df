# SPDX-License-Identifier: MIT
"""Tables for a terminal: scores of an evaluation, and results of tuning and of a benchmark."""

import math
from collections.abc import Mapping, Sequence
from itertools import groupby
from statistics import fmean, geometric_mean
from typing import Any

from rich.markup import escape
from rich.table import Table

from salsanext_cli.errors import counted
from salsanext_cli.measures.scores import FREQUENT_POINTS, Scores
from salsanext_cli.measures.uncertainty_evaluation import (
    CalibrationResult,
    ErrorResult,
    RankingResult,
    UncertaintyEvaluation,
)

ABSENT = "–"


def percent(share: float, digits: int = 1, unit: str = "") -> str:
    """Return a share as a number of percent; "–" for NaN."""
    return ABSENT if math.isnan(share) else f"{100 * share:.{digits}f}{unit}"


def number_table(first: str, *numbers: str, title: str = "", no_wrap: bool = False) -> Table:
    """Return an empty table: a column of names, which may be kept on one line, then numbers."""
    table = Table(title=escape(title) or None, title_justify="left", caption_justify="left")
    table.add_column(first, no_wrap=no_wrap)
    for heading in numbers:
        table.add_column(heading, justify="right")
    return table


# Scores


def score_table(result: Scores, title: str = "") -> Table:
    """Return a table of IoU, precision, recall and points by class, then accuracies and means.

    The mean over the frequent classes is left out where all present are frequent. "–" stands where
    there is nothing to divide by, and for the IoU of a class without points.
    """
    headings = ("class", "IoU %", "precision %", "recall %", "points")
    table = number_table(*headings, title=title, no_wrap=True)
    for c in result.classes:
        iou = c.iou if c.points else math.nan
        shares = (percent(share) for share in (iou, c.precision, c.recall))
        table.add_row(escape(c.name), *shares, f"{c.points:,}")
    table.add_section()
    table.add_row("accuracy", percent(result.accuracy), "", "", f"{result.points:,}")
    table.add_row("accuracy, official", percent(result.accuracy_official))
    table.add_row("mean IoU, official", percent(result.iou_mean_official))
    present = sum(c.points > 0 for c in result.classes)
    table.add_row(f"mean IoU, {present} classes present", percent(result.iou_mean_present))
    frequent = sum(c.points >= FREQUENT_POINTS for c in result.classes)
    if frequent < present:
        name = f"mean IoU, {frequent} classes with ≥ {FREQUENT_POINTS} points"
        table.add_row(name, percent(result.iou_mean_frequent))
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
    softmax, error = evaluation.calibration, evaluation.error
    tables = [_calibration_table(softmax, error)] if softmax or error else []
    return [*tables, _ranking_table(evaluation.kinds)] if evaluation.kinds else tables


def _calibration_table(softmax: CalibrationResult | None, error: ErrorResult | None) -> Table:
    """Return a table of scores of the softmax, and of the ECE of the error."""
    errors = ("ECE %", "ECE per scan %", "ACE %")
    headings = ("calibration", "NLL, nats", "Brier", *errors, "scans", "points")
    table = number_table(*headings, no_wrap=True)
    if softmax:
        scores = softmax.scores
        table.add_row(
            *("softmax", _number(scores.nll), _number(scores.brier)),
            *(percent(each, 2) for each in (scores.ece, softmax.ece_per_scan, scores.ace)),
            *(f"{softmax.scans:,}", f"{scores.points:,}"),
        )
    if error:
        points = f"{error.scores.points:,}"
        table.add_row("error", "", "", percent(error.ece, 2), "", "", f"{error.scans:,}", points)
        table.caption = "error: the probability that a label is wrong"
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


# Tuning


def temperature_table(before: Mapping[str, float], after: Mapping[str, float]) -> Table:
    """Return a table of `temperature`, `nll` in nats and `ece` as a share, before and after."""
    table = number_table("", "temperature", "NLL in nats", "ECE in %", title="Temperature")
    for name, found in (("before", before), ("after", after)):
        cells = (f"{found['temperature']:.4f}", f"{found['nll']:.4f}", f"{100 * found['ece']:.2f}")
        table.add_row(name, *cells)
    return table


def error_table(found: Mapping[str, Any]) -> Table:
    """Return a table of the scores of `error` beside those of `confidence`, on scans left out."""
    names = ("AUROC", "AURC", "ECE in %", "wrong of the best 80 %, in %")
    table = number_table("", *names, title=f"Scans left out, {counted(found['folds'], 'fold')}")
    for name in ("error", "confidence"):
        scores = found[name]
        shares = (f"{100 * scores[key]:.1f}" for key in ("ece", "risk_80"))
        table.add_row(name, f"{scores['auroc']:.3f}", f"{scores['aurc']:.4f}", *shares)
    return table


def rate_table(rates: Sequence[float], objectives: Sequence[float], best: float) -> Table:
    """Return a table of dropout rates and their objectives, the best one marked."""
    table = number_table("rate", "objective per point", title="Dropout rate")
    table.columns[0].justify = "right"
    table.add_column("")
    for rate, objective in zip(rates, objectives, strict=True):
        table.add_row(f"{rate:.4f}", f"{objective:.4f}", "best" if rate == best else "")
    return table


def moved_table(layers: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of how far batch norms moved, by the part of the network that they are in.

    `layers`: `layer`, its name, `shift` in old standard deviations, and `variance_ratio`.
    """
    numbers = ("layers", "mean moved by, σ", "variance, new / old")
    table = number_table("part", *numbers, title="Batch norm")
    for part, members in groupby(layers, lambda layer: layer["layer"].partition(".")[0]):
        _add_moved(table, part, list(members))
    table.add_section()
    _add_moved(table, "all", layers)
    return table


def _add_moved(table: Table, part: str, layers: Sequence[Mapping[str, Any]]) -> None:
    shift = fmean(layer["shift"] for layer in layers)
    ratio = geometric_mean(layer["variance_ratio"] for layer in layers)
    table.add_row(part, str(len(layers)), f"{shift:.3f}", f"{ratio:.3f}")
