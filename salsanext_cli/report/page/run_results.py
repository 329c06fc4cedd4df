# SPDX-License-Identifier: MIT
"""Results of a run: numbers of all scans, points of those to look at, and what was recorded."""

from __future__ import annotations

import csv
import math
import random
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import SalsanextError, UsageError, counted, first_few, shortened
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.reading import present, reading, refusing_damage
from salsanext_cli.fitting.field_of_view import view_text
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.objects import BOX
from salsanext_cli.measures.expected_accuracy import ExpectedAccuracy, expected_accuracy
from salsanext_cli.measures.histograms import lack_of_confidence
from salsanext_cli.measures.risk_control import (
    RISK_BOUND_EXCEEDED,
    KeptLabels,
    RiskBoundCheck,
    promise,
)
from salsanext_cli.measures.scan_counts import SOFTMAX, ScanComparison, ScanCounts, read_softmax
from salsanext_cli.measures.scores import Counts, Scores, accepted, scored_rows, scores
from salsanext_cli.measures.uncertainty_evaluation import (
    UncertaintyEvaluation,
    evaluate_uncertainty,
)
from salsanext_cli.network.card import default_weights, read_card
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ERROR, PREDICTION_STAGES, ScanFile, output_path
from salsanext_cli.results.provenance import Provenance
from salsanext_cli.results.result_folder import ResultFolder, ScanResults, read_kind
from salsanext_cli.results.selection import MissingResults
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.results.uncertainty_kinds import MEANT_BY_UNCERTAINTY, UNCERTAINTY
from salsanext_cli.sensors.sensor import Sensor

LEADING_KINDS = ("error", "entropy", *UNCERTAINTY)
"""Kinds of uncertainty by how well they tell which scan is uncertain."""
UNCERTAIN = (*dict.fromkeys(("error", *MEANT_BY_UNCERTAINTY, *UNCERTAINTY)),)
"""Values by which points can be hidden, in the order in which they are offered."""
SCALARS = (*UNCERTAIN, "range", "intensity")  # Values that are shown on a scale; labels are not
DEFAULT_LIMITS = (
    "On real scans they find fences where there are none, take trucks for fence, sidewalk, "
    "building or car, hardly tell parking from road and sidewalk, and hardly ever find cyclists."
)
"""Failures of the default weights, as model-card.md has them; it does not come with a page."""
SHOWN_DIGITS = 12  # Hexadecimal digits of a SHA-256 that are shown
CHECKED_STAGES = ("project", *PREDICTION_STAGES)  # They keep reasons to doubt scans


@dataclass(frozen=True, slots=True, eq=False)
class ScanRow:
    """One scan in numbers."""

    file: ScanFile
    points: int  # Number of its points that have a label or an uncertainty
    class_points: Counts | None  # (C,) int64 or None: number of points by predicted train id
    uncertainty: dict[str, float]  # Mean over the points by kind; NaN without any
    # (C, C) as `scored_rows`, of a run that rejected labels those accepted; None without labels
    confusion: Counts | None = None

    @property
    def wrong(self) -> float:
        """Share of the points of `confusion` that is wrong, 0…1; NaN without any."""
        if self.confusion is None or not self.confusion.any():
            return math.nan
        return float(1 - self.confusion.trace() / self.confusion.sum())


def read_row(file: ScanFile, reader: ScanComparison) -> tuple[ScanRow, ScanCounts | None]:
    """Read the results of a scan, and count them against its labels if there are both."""
    out, space = reader.out, reader.space
    path_of = partial(output_path, out, file.sequence, stem=file.stem)
    class_points, points = None, 0
    if present(path := path_of(folder="predictions")):
        predicted = space.to_train(read_labels(path), strict=False, source=path)
        points = len(predicted)
        class_points = np.bincount(predicted, minlength=space.class_count)
    uncertainty = {}
    for kind in UNCERTAINTY:
        if present(path := path_of(folder=f"uncertainty/{kind}")):
            values = read_kind(path, kind, points or None)
            points = len(values)
            finite = values[np.isfinite(values)]
            uncertainty[kind] = float(finite.mean(dtype=np.float64)) if len(finite) else math.nan
    if class_points is None or not present(file.label_path):
        return ScanRow(file, points, class_points, uncertainty), None
    counts = reader.count(file)
    confusion = scored_rows(counts.confusion, space)
    confusion = accepted(confusion) if reader.rejection else confusion
    return ScanRow(file, points, class_points, uncertainty, confusion), counts


@dataclass(frozen=True, slots=True, eq=False)
class ShownScan:
    """Scan to show point by point."""

    name: str  # Sequence and stem
    reason: str  # Why it is shown
    results: ScanResults  # N points and what is known about them
    boxes: Sequence[Sequence[float]] = ()  # Train id and `BOX` of every object

    def values(self) -> dict[str, npt.NDArray[Any]]:
        """Return all values of `SCALARS` that are known, (N,) each."""
        results = self.results
        measured = {"range": results.range, "intensity": results.scan.intensity}
        known = results.uncertainty | measured
        return {name: known[name] for name in SCALARS if name in known}


def read_boxes(path: Path, space: LabelSpace) -> list[list[float]]:
    """Read the table of objects that `predict` wrote; classes that were merged since are 0."""
    if not present(path):
        return []
    train_ids = {name: i for i, name in enumerate(space.names)}
    with reading(path) as file, refusing_damage(path, "a table of `predict --objects`"):
        table = csv.DictReader(file.read().decode().splitlines())
        boxes = [
            [train_ids.get(row["class"], 0), *(float(row[name]) for name in BOX)] for row in table
        ]
        if not np.isfinite(boxes).all():
            raise ValueError("a number that is not finite")
    return boxes


@dataclass(frozen=True, slots=True)
class Comparison:
    """Comparison of the scans that have labels with these."""

    counts: ScanCounts  # Counts of their points; of a run that rejected labels, of accepted ones
    scores: Scores  # Scores of the labels
    uncertainty: UncertaintyEvaluation  # Results for the probabilities and uncertainties
    kept: KeptLabels | None  # Coverage and risk of a run that rejected labels
    sentences: list[str]  # The same in words, and the promise of the run


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """Results of a run in numbers per scan."""

    reader: ScanComparison
    rows: Sequence[ScanRow]  # Scans that could be read, in their order; at least one
    counts: ScanCounts | None  # Of the scans with labels; None without any
    missing: MissingResults  # Scans without results, left out

    def read(self, row: ScanRow, reason: str = "") -> ShownScan:
        """Read a scan to be shown, its results, and the confidence of its points."""
        file, reader, space = row.file, self.reader, self.reader.space
        results = ResultFolder(reader.out).read(file, reader.sensor, space, (reader.labels, space))
        if present(path := output_path(reader.out, file.sequence, SOFTMAX, file.stem)):
            every = np.ones(len(results.scan), bool)
            softmax = read_softmax(path, every, space, reader.merging)
            results.uncertainty["least_confidence"] = lack_of_confidence(softmax)
        boxes = read_boxes(output_path(reader.out, file.sequence, "objects", file.stem), space)
        return ShownScan(row.file.name, reason, results, boxes)

    def compared(self) -> Comparison | None:
        """Divide the counts; None without labels."""
        if self.counts is None:
            return None
        counts, space, kept = self.counts, self.reader.space, None
        uncertainty = evaluate_uncertainty(counts, space)
        if counts.kept:
            kept = KeptLabels.of_confusion(counts.confusion, space, counts.kept)
            bands = tuple(map(accepted, counts.bands))
            counts = replace(counts, confusion=accepted(counts.confusion), bands=bands)
        sentences = [*(kept.sentences if kept else ())]
        sentences += [self.promise.sentence] if self.promise else []
        return Comparison(counts, scores(counts.confusion, space), uncertainty, kept, sentences)

    @property
    def promise(self) -> RiskBoundCheck | None:
        """Promise of the labels that are kept, beside what is found."""
        promised = Provenance(self.reader.out).promised(self.reader.space)
        if self.counts is None or promised is None:
            return None
        return RiskBoundCheck.of_scans(promised, self.counts.kept)

    def warnings(self) -> list[str]:
        """Return every reason to doubt the page, a line each."""
        files = [row.file for row in self.rows]
        wanted = {name for file in files for name in (file.name, file.sequence)}
        lines = warnings_of_run(self.reader.out, wanted)
        if self.counts:
            lines = [*self.counts.label_warnings(self.reader.space), *lines]
        if self.promise and self.promise.is_exceeded:
            lines = [RISK_BOUND_EXCEEDED, *lines]
        if self.missing.scans:
            lines.append(f"{counted(len(self.missing.scans), 'scan')} without results left out")
        return lines


def leading_kind(rows: Sequence[ScanRow]) -> str | None:
    """Return the first of `LEADING_KINDS` that is known of some scan, None without any."""
    return next((kind for kind in LEADING_KINDS if any(kind in r.uncertainty for r in rows)), None)


def worth_looking_at(rows: Sequence[ScanRow], space: LabelSpace) -> dict[str, str]:
    """Choose the most uncertain, most wrong, worst-class and a random scan; return why, by name."""
    reasons: dict[str, list[str]] = {}

    def add_largest(values: Sequence[float], reason: Callable[[float], str]) -> None:
        place = int(np.nan_to_num(values).argmax())
        if values[place] > 0:
            reasons.setdefault(rows[place].file.name, []).append(reason(values[place]))

    if kind := leading_kind(rows):
        means = [row.uncertainty.get(kind, math.nan) for row in rows]
        words = f"most uncertain (mean {kind.replace('_', ' ')}"
        add_largest(means, lambda value: f"{words} {value:.3g})")
    wrong = [row.wrong for row in rows]
    add_largest(wrong, lambda share: f"most wrong ({100 * share:.1f} % of the points with a label)")
    worst = _worst_class(rows, space)
    if worst is not None:
        missed = [_missed(row.confusion, worst) for row in rows]
        name = space.names[worst]
        add_largest(missed, lambda n: f"worst class: {n:,.0f} points of {name} wrong")
    if left := [row for row in rows if row.file.name not in reasons]:
        # The same for the same scans.
        reasons[random.Random(len(rows)).choice(left).file.name] = ["at random"]
    return {name: ", ".join(given) for name, given in reasons.items()}


def _worst_class(rows: Sequence[ScanRow], space: LabelSpace) -> int | None:
    """Return the class of the lowest IoU of those that the truth holds."""
    confusion = np.zeros((space.class_count, space.class_count), np.int64)
    for row in rows:
        confusion += 0 if row.confusion is None else row.confusion
    held = [each for each in scores(confusion, space).classes if each.points]
    return min(held, key=lambda each: each.iou).train_id if held else None


def _missed(confusion: Counts | None, train_id: int) -> float:
    """Return the number of points of a class, or called so, that are wrong."""
    if confusion is None:
        return math.nan
    of_class = confusion[train_id].sum() + confusion[:, train_id].sum()
    return float(of_class - 2 * confusion[train_id, train_id])


def named(rows: Sequence[ScanRow], names: Sequence[str]) -> dict[str, str]:
    """Choose scans by name, ``08/000000``, or by stem where only one sequence has it."""
    chosen: dict[str, str] = {}
    for name in names:
        found = [row.file.name for row in rows if name in (row.file.name, row.file.stem)]
        if len(found) != 1:
            what = f"{len(found)} scans" if found else "no results of a scan of that name"
            there = first_few(found or [row.file.name for row in rows])
            raise UsageError("--scans", f"{name}: {what}", f"names such as {there}")
        chosen[found[0]] = "named"
    return chosen


def facts_of_run(out: Path, sensor: Sensor) -> Iterator[tuple[str, str]]:
    """Yield what was run and how, as pairs of a title and a text."""
    records = Provenance(out)
    yield "Weights", _weights(records)
    for each in sensor.members:
        yield "Sensor", f"{each.name}, {each.height}×{each.width}, {view_text(each)}"
    stage, of_labels = records.owner("predictions"), records.settings_of("predictions")
    if stage and of_labels:
        yield "Labels", _labels(stage, of_labels)
        if of_labels.promised:
            yield "Promise", promise(of_labels.promised)
        if of_labels.inherited:
            yield "Inherited", f"{shortened(of_labels.inherited, 200)}, not fitted to these weights"
    if settings := records.settings("uncertainty"):
        numbers = {name: getattr(settings, name) for name in ("samples", "seed", "aleatoric")}
        given = (f"{name} {value}" for name, value in numbers.items() if value is not None)
        yield "Uncertainty", ", ".join([str(settings.method), *given])
    if records.owner(ERROR) == "predict":
        yield "Uncertainty", "probability of error, of predict --error"


def expected_of_run(out: Path, rows: Sequence[ScanRow]) -> ExpectedAccuracy | None:
    """Estimate the accuracy of labels that `predict` wrote; None for those of other stages."""
    records = Provenance(out)
    settings = records.settings("predict")
    if settings is None or records.owner("predictions") != "predict":
        return None
    means = {row.file.name: row.uncertainty.get("least_confidence", math.nan) for row in rows}
    confidences = {name: 1 - mean for name, mean in means.items() if not math.isnan(mean)}
    warnings: dict[str, list[str]] = {}
    for name, findings in OwnedFolder(out, "predict").findings().items():
        for code, *_ in findings:
            warnings.setdefault(code, []).append(name)
    return expected_accuracy(settings.accuracy, confidences, warnings)


def _weights(records: Provenance) -> str:
    """Describe the weights behind the labels, else those behind the uncertainty."""
    folders = ("predictions", "uncertainty/epistemic", "uncertainty/error", "pixel_labels")
    sha256 = next(filter(None, map(records.weights, folders)), None)
    if sha256 is None:
        return "not recorded"
    name = f"SHA-256 {sha256[:SHOWN_DIGITS]}"
    path = default_weights()
    # An installation without its weights still has results to show.
    with suppress(SalsanextError):
        if fingerprint(path) == sha256:
            card = read_card(path)
            own = re.sub(r"See docs/\S+ (.)", lambda rest: rest[1].upper(), card.description)
            name = card.named(path) if card.version else f"the default ones, {name}"
            return f"{name}. {own.replace('`', '')} {DEFAULT_LIMITS}"
    return f"{name}, not the default ones; salsanext models FILE describes a file of weights"


def _labels(stage: str, settings: StageSettings) -> str:
    words = [stage]
    if settings.engine:
        words.append(f"{settings.engine} in {settings.precision}")
    if settings.temperature is not None:
        words.append(f"temperature {settings.temperature:.3g}")
    if settings.reject is not None:
        kind = (settings.reject_by or "error").replace("_", " ")
        words.append(f"points unlabelled whose {kind} is above {settings.reject:g}")
    return ", ".join(words)


def warnings_of_run(out: Path, wanted: Collection[str]) -> list[str]:
    """Return what was found doubtful about wanted scans and sequences, a line for each kind."""
    words: dict[str, dict[str, str]] = {}  # By code and name
    for stage in CHECKED_STAGES:
        for name, findings in OwnedFolder(out, stage).findings().items():
            for code, message, hint in findings if name in wanted else ():
                words.setdefault(code, {}).setdefault(name, f"{message}; {hint}")
    return [
        f"{code} in {counted(len(of), 'scan' if '/' in min(of) else 'sequence')} "
        f"({first_few([*of])}): {next(iter(of.values()))}"
        for code, of in sorted(words.items())
    ]
