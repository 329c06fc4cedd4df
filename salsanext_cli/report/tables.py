# SPDX-License-Identifier: MIT
"""Tables for a terminal: scores, tuning, sets of scans, imported labels."""

import math
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from pathlib import Path

from rich.console import Group
from rich.table import Table
from rich.text import Text

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.calibration import CalibrationScores
from salsanext_cli.core.measures.risk_control import needed_scans, useful_scans
from salsanext_cli.core.measures.scores import FREQUENT_POINTS, Scores, band_scores
from salsanext_cli.core.measures.survey import Survey
from salsanext_cli.core.measures.uncertainty_evaluation import RankingScores, UncertaintyEvaluation
from salsanext_cli.core.records import CHANNELS
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few, percentage, printable
from salsanext_cli.core.wording import share
from salsanext_cli.io.annotation_tools.registry import TOOLS
from salsanext_cli.runs.annotation.label_records import ImportedScan, LabelImport

ABSENT = "–"
USUAL_LIMITS = (0.05, 0.1, 0.2)
USUAL_CONFIDENCES = (0.8, 0.9, 0.95)
IMPORTED = ("points", "labelled", "unlabelled", "ambiguous", "missing")
"""Fields of `ImportedScan` that are numbers of points."""


def percent(share: float, digits: int = 1, unit: str = "") -> str:
    """Return a share in percent, "–" for NaN."""
    return ABSENT if math.isnan(share) else f"{100 * share:.{digits}f}{unit}"


def table_of(
    headings: Sequence[str],
    rows: Iterable[Sequence[str]],
    *,
    totals: Iterable[Sequence[str]] = (),
    texts: Collection[str] = (),
    title: str = "",
    caption: str = "",
) -> Table:
    """Return a table of a name, of columns of numbers or `texts`, and of `totals` below a line."""
    table = Table(title=Text(title) if title else None, caption=caption or None)
    table.title_justify = table.caption_justify = "left"
    for heading in headings:
        if heading in (headings[0], *texts):
            table.add_column(heading, overflow="fold")
        else:
            table.add_column(heading, justify="right", no_wrap=True)
    for part in (rows, totals):
        table.add_section()
        for row in part:
            table.add_row(*(Text(printable(cell)) for cell in row))
    return table


def score_table(result: Scores, title: str = "") -> Table:
    """Return a table of IoU, precision, recall and points by class, then of accuracy and means."""
    rows = []
    for c in result.classes:
        iou = c.iou if c.points else math.nan
        rows.append((c.name, *map(percent, (iou, c.precision, c.recall)), f"{c.points:,}"))
    present = sum(c.points > 0 for c in result.classes)
    totals = [
        ("accuracy, all labelled points", percent(result.accuracy), "", "", f"{result.points:,}"),
        ("accuracy, predicted (official)", percent(result.accuracy_official)),
        (f"mean IoU, all {len(result.classes)} (official)", percent(result.iou_mean_official)),
        (f"mean IoU, {present} classes present", percent(result.iou_mean_present)),
    ]
    frequent = sum(c.points >= FREQUENT_POINTS for c in result.classes)
    if frequent < present:
        name = f"mean IoU, {frequent} with ≥ {FREQUENT_POINTS} points"
        totals.append((name, percent(result.iou_mean_frequent)))
    headings = ("class", "IoU %", "precision %", "recall %", "points")
    return table_of(headings, rows, totals=totals, title=title)


def band_table(bands: Mapping[str, Scores]) -> Table:
    """Return a table of mean IoU of the same classes and accuracy by distance band."""
    rows = (
        (
            band.name,
            percent(band.iou_mean_same),
            percent(band.scores.accuracy),
            f"{band.scores.points:,}",
            ", ".join(band.absent),
        )
        for band in band_scores(bands)
    )
    headings = ("distance", "mean IoU % of\nthe same classes", "accuracy %", "points")
    return table_of((*headings, "absent classes"), rows, texts=["absent classes"])


def uncertainty_tables(evaluation: UncertaintyEvaluation) -> list[Table]:
    """Return a table of the calibration and one of the kinds of uncertainty, as far as known."""
    softmax = evaluation.calibration
    error = evaluation.kinds.get("error")
    tables = [_calibration_table(softmax, error)] if softmax or error else []
    return [*tables, _ranking_table(evaluation.kinds)] if evaluation.kinds else tables


def _calibration_table(softmax: CalibrationScores | None, error: RankingScores | None) -> Table:
    rows: list[Sequence[str]] = []
    caption = ""
    if softmax:
        likelihood = (_number(softmax.nll), _number(softmax.brier))
        shares = (percent(s, 2) for s in (softmax.ece, softmax.ece_per_scan))
        rows.append(("softmax", *likelihood, *shares, f"{softmax.scans:,}", f"{softmax.points:,}"))
    if error and error.ece is not None:
        counts = (f"{error.scans:,}", f"{error.points:,}")
        rows.append(("error", "", "", percent(error.ece, 2), "", *counts))
        mean = percent(error.mean)
        wrong = percent(error.wrong / max(error.points, 1))
        caption = f"kind `error`, the probability of a wrong label: mean {mean} %, wrong {wrong} %"
    errors = ("ECE %,\nall points", "ECE %, mean\nof scans")
    headings = ("calibration", "NLL,\nnats", "Brier", *errors, "scans", "points")
    return table_of(headings, rows, caption=caption)


def _ranking_table(kinds: Mapping[str, RankingScores]) -> Table:
    rows = []
    for kind, scores in kinds.items():
        wrong = scores.wrong / scores.points if scores.points else math.nan
        areas = (percent(scores.auroc), percent(scores.aupr), percent(scores.aurc, 2))
        rows.append((kind, *areas, percent(wrong), f"{scores.points:,}"))
    headings = ("AUROC\n%", "AUPR\n%", "AURC\n%", "wrong\n%", "points")
    return table_of(("uncertainty", *headings), rows)


def _number(value: float) -> str:
    return ABSENT if math.isnan(value) else f"{value:.3f}"


def accepted_table(classes: Mapping[str, tuple[int, int]]) -> Table:
    """Return a table of accepted and wrong points by predicted class."""
    rows = [
        (name, f"{accepted:,}", percent(wrong / accepted if accepted else math.nan))
        for name, (accepted, wrong) in classes.items()
    ]
    return table_of(("labelled as", "accepted points", "wrong %"), rows, title="Accepted labels")


def needed_scans_table(at_most: float, confidence: float | None = None) -> Table:
    """Return a table of the least numbers of scans and drives for a level, and for usual ones.

    `at_most`, `confidence`: limit of the share of wrong points, and confidence, 0…1.
    """
    rows = []
    for limit in sorted({at_most, *USUAL_LIMITS}, reverse=True):
        scans = needed_scans(limit, None)
        drives = useful_scans(limit, None)
        rows.append((f"{percentage(limit, figures=3)} on average", str(scans), str(drives)))
    for level in sorted({*USUAL_CONFIDENCES, *([confidence] if confidence else [])}):
        units = str(needed_scans(at_most, level))
        rows.append((f"any limit, {share('confidence', level)}", units, units))
    columns = ("limit", "scans, for the same drives", "drives, for other drives")
    return table_of(columns, rows, title="Least numbers")


def rate_table(rates: Sequence[float], objectives: Sequence[float], best: float) -> Table:
    """Return a table of dropout rates and their objectives, the best one marked."""
    rows = (
        (f"{rate:.4f}", f"{objective:.4f}", "best" if rate == best else "")
        for rate, objective in zip(rates, objectives, strict=True)
    )
    return table_of(("rate", "objective per point", ""), rows, title="Dropout rate")


def survey_tables(
    sequences: Mapping[str, Survey], total: Survey, space: LabelSpace, sensor: Sensor | None = None
) -> Group:
    """Return tables of the sequences and, with labels, the classes.

    `sensor`: sensor of range images whose channels get a table.
    """
    surveys = dict(sequences)
    if len(sequences) > 1:
        surveys["all"] = total
    counts = []
    measured = []
    for name, survey in surveys.items():
        smallest = min(survey.smallest, survey.largest)
        up, down = survey.field_of_view()
        per_scan = f"{smallest:,} – {survey.largest:,}"
        invalid = f"{survey.invalid:,}"
        counts.append((name, f"{survey.scans:,}", f"{survey.labelled:,}", per_scan, invalid))
        largest = (f"{survey.farthest:.1f}", f"{survey.brightest:.3g}")
        measured.append((name, *largest, f"{up:+.2f}° to {down:+.2f}°"))
    headings = ("sequence", "scans", "labelled", "points per scan", "invalid points")
    tables = [
        table_of(headings, counts, title="Scans"),
        table_of(("sequence", "farthest, m", "brightest", "field of view"), measured),
    ]
    if sensor:
        tables.append(_channel_table(total, sensor))
    if total.classes:
        tables.append(_class_table(total, space))
    return Group(*tables)


def _channel_table(total: Survey, sensor: Sensor) -> Table:
    title = f"Range images of {sensor.name}, {sensor.height}×{sensor.width}"
    rows = (
        (name, f"{mean:.3f}", f"{std:.3f}")
        for name, mean, std in zip(CHANNELS, total.means, total.stds, strict=True)
    )
    return table_of(("channel", "mean", "standard deviation"), rows, title=title)


def _class_table(total: Survey, space: LabelSpace) -> Table:
    points = sum(total.classes.values())
    rows = []
    for raw, count in sorted(total.classes.items()):
        train = space.learning_map.get(raw)
        train_class = "unknown" if train is None else f"{train} {space.names[train]}"
        name = f"{raw} {space.labels.get(raw, 'unknown')}"
        rows.append((name, train_class, f"{count:,}", f"{100 * count / points:.3f}"))
    headings = ("raw id and name", "train id and class", "points", "share %")
    return table_of(headings, rows, texts=headings[1:2], title="Classes")


def imported_table(scans: Sequence[ImportedScan]) -> Table:
    """Return a table of the numbers of points of every imported scan, and of all."""
    points = [[getattr(scan, name) for name in IMPORTED] for scan in scans]
    rows = (
        (scan.scan, *map("{:,}".format, numbers), scan.scalar)
        for scan, numbers in zip(scans, points, strict=True)
    )
    totals = map(sum, zip(*points, strict=True))
    all_scans = ("all", *(f"{total:,}" for total in totals))
    return table_of(("scan", *IMPORTED, "from"), rows, totals=[all_scans], texts=["from"])


def _files_of_tools(scans: Sequence[ImportedScan]) -> str:
    """Return what was read, with the number of scans, by labelling tool."""
    counts = sorted(Counter(scan.tool for scan in scans).items(), reverse=True)
    saved = {tool: TOOLS[tool].saves if tool else "other files" for tool, _ in counts}
    return ", ".join(f"{saved[tool]} ({counted(count, 'scan')})" for tool, count in counts)


def imported_lines(made: LabelImport, dataset: Path) -> Iterator[str]:
    """Yield a line about the imported scans, and one about every group of other scans."""
    failed = sum(len(failure.files) for failure in made.failures)
    others = f", {counted(failed, 'file')} failed" if failed else ""
    yield f"import-labels: {counted(len(made.scans), 'scan')}{others} → {dataset}"
    if made.scans:
        yield f"read: {_files_of_tools(made.scans)}"
    shares = made.largest_classes()
    if shares:
        named = ", ".join(f"{name} {percentage(share)}" for name, share in shares.items())
        yield f"largest classes: {named}"
    if made.unedited:
        files = f"{counted(len(made.unedited), 'file')}: {first_few(made.unedited)}"
        yield f"not imported, unedited pre-labels of `pick`: {files}"
    if made.unchanged:
        yield f"unchanged, without an edited file: {counted(made.unchanged, 'scan')}"
    if made.pre_labelled:
        scans = f"{counted(len(made.pre_labelled), 'scan')}: {first_few(made.pre_labelled)}"
        yield f"warning: labels are unedited pre-labels of `pick`, {scans}"
