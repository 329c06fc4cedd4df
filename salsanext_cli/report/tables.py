# SPDX-License-Identifier: MIT
"""Tables for a terminal: scores, tuning, networks and weights, sets of scans, imported labels."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted, first_few, printable
from salsanext_cli.labelling.label_records import LabelImport
from salsanext_cli.measures.risk_control import promise
from salsanext_cli.measures.scores import FREQUENT_POINTS, Scores, ring_rows
from salsanext_cli.measures.survey import Survey
from salsanext_cli.measures.uncertainty_evaluation import (
    CalibrationResult,
    RankingResult,
    UncertaintyEvaluation,
)
from salsanext_cli.records import CHANNELS
from salsanext_cli.sensors.sensor import Sensor

ABSENT = "–"
NETWORK_NOTES = """* not the paper's number of parameters to the digit
† the paper does not determine this network: the nearest reading"""
IMPORTED = ("points", "labelled", "unlabelled", "ambiguous", "missing")
"""Numbers of points of a scan whose labels are imported."""


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


def score_table(result: Scores, title: str = "") -> Table:
    """Return a table of IoU, precision, recall and points by class, then accuracies and means."""
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
    """Return a table with a row per ring of distance: mean IoU of the same classes, accuracy."""
    table = number_table("distance", "mean IoU % of the same classes", "accuracy %", "points")
    table.add_column("absent classes")
    for name, result, mean, absent in ring_rows(rings):
        shares = (percent(share) for share in (mean, result.accuracy))
        table.add_row(name, *shares, f"{result.points:,}", escape(", ".join(absent)))
    return table


def uncertainty_tables(evaluation: UncertaintyEvaluation) -> list[Table]:
    """Return a table of the calibration and one of the kinds of uncertainty; none without any."""
    softmax, error = evaluation.calibration, evaluation.kinds.get("error")
    tables = [_calibration_table(softmax, error)] if softmax or error else []
    return [*tables, _ranking_table(evaluation.kinds)] if evaluation.kinds else tables


def _calibration_table(softmax: CalibrationResult | None, error: RankingResult | None) -> Table:
    errors = ("ECE %", "ECE per scan %", "ACE %")
    headings = ("calibration", "NLL, nats", "Brier", *errors, "scans", "points")
    table = number_table(*headings, no_wrap=True)
    if softmax:
        scores = softmax.scores
        table.add_row(
            "softmax",
            _number(scores.nll),
            _number(scores.brier),
            percent(scores.ece, 2),
            percent(softmax.ece_per_scan, 2),
            percent(scores.ace, 2),
            f"{softmax.scans:,}",
            f"{scores.points:,}",
        )
    if error and error.ece is not None:
        points = f"{error.scores.points:,}"
        table.add_row("error", "", "", percent(error.ece, 2), "", "", f"{error.scans:,}", points)
        table.caption = "error: the probability that a label is wrong"
    return table


def _ranking_table(kinds: Mapping[str, RankingResult]) -> Table:
    columns = ("AUROC %", "AUPR %", "AURC %", "AUSE", "wrong %", "scans", "points")
    table = number_table("uncertainty", *columns, no_wrap=True)
    for kind, result in kinds.items():
        scores = result.scores
        wrong = scores.wrong / scores.points if scores.points else math.nan
        table.add_row(
            kind,
            percent(scores.auroc),
            percent(scores.aupr),
            percent(scores.aurc, 2),
            _number(scores.ause),
            percent(wrong),
            f"{result.scans:,}",
            f"{scores.points:,}",
        )
    return table


def _number(value: float) -> str:
    return ABSENT if math.isnan(value) else f"{value:.3f}"


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


def kept_table(classes: Mapping[str, tuple[int, int]]) -> Table:
    """Return a table of the kept points of each predicted class and of the wrong ones of them."""
    table = number_table("labelled as", "kept points", "wrong %", title="Kept labels")
    for name, (kept, wrong) in classes.items():
        table.add_row(escape(name), f"{kept:,}", percent(wrong / kept))
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
    """Return a table of how far batch norms moved, by the part of the network that they are in."""
    numbers = ("layers", "mean moved by, σ", "variance, new / old")
    table = number_table("part", *numbers, title="Batch norm")

    def add(part: str, members: Sequence[Mapping[str, Any]]) -> None:
        shift = fmean(layer["shift"] for layer in members)
        ratio = geometric_mean(layer["variance_ratio"] for layer in members)
        table.add_row(part, str(len(members)), f"{shift:.3f}", f"{ratio:.3f}")

    for part, members in groupby(layers, lambda layer: layer["layer"].partition(".")[0]):
        add(part, list(members))
    table.add_section()
    add("all", layers)
    return table


def network_table(networks: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of the costs of networks, with the papers' figures in brackets."""
    costs = ("parameters", "multiply-accumulates at 64×2048 (FLOPs)", "receptive field")
    headings = ("name", *costs, "mIoU without kNN, with, on test")
    title = "Networks, with the papers' figures in brackets"
    table = number_table(*headings, title=title, no_wrap=True)
    table.caption = NETWORK_NOTES
    for network in networks:
        paper = network["paper"]
        marks = ("" if network["agrees"] else "*") + ("" if paper["determined"] else "†")
        height, width = network["receptive_field"]
        flops = f"({paper['flops']} G)" if paper["flops"] else "(–)"
        table.add_row(
            network["name"] + marks,
            f"{network['parameters']:,} ({paper['parameters']} M)",
            f"{network['multiply_accumulates'] / 1e9:.2f} G {flops:>10}",
            f"{height}×{width}",
            ", ".join(f"{paper[key] or '–':>4}" for key in ("miou_pixels", "miou", "miou_test")),
        )
    return table


def card_table(card: Mapping[str, Any]) -> Table:
    """Return a table of the card of a weights file."""
    sensor = card["sensor"]
    table = Table(title=escape(card["path"]), title_justify="left", show_header=False)
    table.add_row("what", escape(card["description"]) or "–")
    table.add_row("architecture", ", ".join(f"{k} {v}" for k, v in card["architecture"].items()))
    table.add_row("temperature", f"{card['temperature']:.4g}")
    table.add_row("label space", escape(f"{card['label_space']}, {len(card['classes'])} classes"))
    view = f"{sensor['fov_up']:+g}° to {sensor['fov_down']:+g}°"
    size = f"{sensor['height']}×{sensor['width']}"
    table.add_row("sensor", escape(f"{sensor['name']}, {size}, {view}"))
    table.add_row("scores of the scans that chose the weights", _scores(card["scores"]) or "–")
    if card["error"] is not None:
        table.add_row("model of errors, on scans left out", _scores(card["error"]) or "–")
    if card["risk"] is not None:
        table.add_row("threshold of risk", escape(promise(card["risk"])))
    if card["trained_on"]:
        table.add_row("scans known from training", f"{card['trained_on']:,}")
    table.add_row("size", f"{card['bytes'] / 1e6:.1f} MB")
    table.add_row("SHA-256", card["sha256"])
    return table


def _scores(scores: Mapping[str, Any]) -> str:
    """Return names and rounded numbers; further digits depend on a few scans."""
    return escape(", ".join(f"{name} {_rounded(value)}" for name, value in scores.items()))


def _rounded(value: Any) -> str:
    """Return a score as text; of several, each with its name or without."""
    if isinstance(value, Mapping):
        return f"({', '.join(f'{name} {_rounded(each)}' for name, each in value.items())})"
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def survey_tables(
    sequences: Mapping[str, Survey], total: Survey, space: LabelSpace, sensor: Sensor
) -> Group:
    """Return tables of the sequences, of the channels and, if there are labels, of the classes."""
    title = f"Range images of {sensor.name}, {sensor.height}×{sensor.width}"
    channels = number_table("channel", "mean", "standard deviation", title=title)
    for name, mean, std in zip(CHANNELS, total.means, total.stds, strict=True):
        channels.add_row(name, f"{mean:.3f}", f"{std:.3f}")
    classes = [_classes(total, space)] if total.classes else []
    return Group(_sequences(sequences, total), channels, *classes)


def _sequences(sequences: Mapping[str, Survey], total: Survey) -> Table:
    numbers = ("scans", "labelled", "points per scan", "invalid points", "farthest, m", "brightest")
    table = number_table("sequence", *numbers, "field of view", title="Scans")
    rows = dict(sequences) | ({"all": total} if len(sequences) > 1 else {})
    for name, found in rows.items():
        up, down = found.field_of_view()
        table.add_row(
            escape(printable(name)),
            f"{found.scans:,}",
            f"{found.labelled:,}",
            f"{min(found.smallest, found.largest):,} – {found.largest:,}",
            f"{found.invalid:,}",
            f"{found.farthest:.1f}",
            f"{found.brightest:.3g}",
            f"{up:+.2f}° to {down:+.2f}°",
        )
    return table


def _classes(total: Survey, space: LabelSpace) -> Table:
    numbers = ("train id and class", "points", "share %")
    table = number_table("raw id and name", *numbers, title="Classes")
    points = sum(total.classes.values())
    for raw, count in sorted(total.classes.items()):
        train = space.learning_map.get(raw)
        table.add_row(
            escape(f"{raw} {space.labels.get(raw, 'unknown')}"),
            "unknown" if train is None else escape(f"{train} {space.names[train]}"),
            f"{count:,}",
            f"{100 * count / points:.3f}",
        )
    return table


def imported_table(scans: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table with the numbers of points of each imported scan, and of all."""
    table = number_table("scan", *IMPORTED, no_wrap=True)
    table.add_column("from")
    for scan in scans:
        counts = (f"{scan[name]:,}" for name in IMPORTED)
        table.add_row(escape(scan["scan"]), *counts, escape(scan["scalar"]))
    table.add_section()
    totals = (sum(scan[name] for scan in scans) for name in IMPORTED)
    table.add_row("all", *(f"{total:,}" for total in totals))
    return table


def imported_lines(made: LabelImport, dataset: Path) -> Iterator[str]:
    """Yield a line about what was imported, and one about each group of scans that was not."""
    failed = sum(len(failure["files"]) for failure in made.failures)
    others = f", {counted(failed, 'file')} failed" if failed else ""
    yield f"import-labels: {counted(len(made.scans), 'scan')}{others} → {dataset}"
    if shares := made.largest_classes():
        named = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
        yield f"largest classes: {named}"
    if made.unedited:
        files = f"{counted(len(made.unedited), 'file')}: {first_few(made.unedited)}"
        yield f"not imported, since they hold the first guess of `pick`, {files}"
    if made.kept:
        yield f"without an edited file, as they were: {counted(made.kept, 'scan')}"
    if made.first_guesses:
        scans = f"{counted(len(made.first_guesses), 'scan')}: {first_few(made.first_guesses)}"
        yield f"warning: labelled by the network only, as `pick` left them, {scans}"
