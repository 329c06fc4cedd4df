# SPDX-License-Identifier: MIT
"""Results of a run: numbers of all scans, points of some scans, and the recorded settings."""

from __future__ import annotations

import csv
import math
import random
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.objects import BOX
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import SOFTMAX, ScanCounts
from salsanext_cli.core.measures.decision import Evidence
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy, expected_accuracy
from salsanext_cli.core.measures.histograms import lack_of_confidence
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import Scores, accepted, scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.core.uncertainty.kinds import DEFAULT_UNCERTAINTIES, UNCERTAINTY
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.reading import present, reading, refusing_damage
from salsanext_cli.report.page.mean_uncertainty import mean_in_words
from salsanext_cli.report.page.recorded_facts import recorded_facts
from salsanext_cli.report.page.recorded_warnings import codes_by_scan, warnings_of_run
from salsanext_cli.report.page.scan_row import PointErrors, ScanRow
from salsanext_cli.runs.results.output_paths import find_outputs, output_path
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_results import ScanResults
from salsanext_cli.runs.scans.named_scans import named_scans
from salsanext_cli.runs.scans.selection import MissingResults
from salsanext_cli.runs.summary.comparison import ScanComparison, read_softmax
from salsanext_cli.runs.summary.guarantee_of_run import guarantee_of_run

LEADING_KINDS = ("error", "entropy", *UNCERTAINTY)
"""Kinds of uncertainty, the best indicator of an uncertain scan first."""
UNCERTAIN = (*dict.fromkeys(("error", *DEFAULT_UNCERTAINTIES, *UNCERTAINTY)),)
"""Values by which points can be hidden, in the order of the menu."""
SCALARS = (*UNCERTAIN, "range", "intensity")  # Values with a scale


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ShownScan:
    """Scan to show point by point."""

    name: str  # Sequence and stem
    reason: str  # Why the scan was chosen
    results: ScanResults  # N points
    boxes: Sequence[Sequence[float]] = ()  # Train id and `BOX` of every object

    def values(self) -> dict[str, npt.NDArray[Any]]:
        """Return the known values of `SCALARS`, arrays (N,)."""
        results = self.results
        measured = {"range": results.range, "intensity": results.scan.intensity}
        values = results.uncertainty | measured
        return {name: values[name] for name in SCALARS if name in values}


def read_boxes(path: Path, space: LabelSpace) -> list[list[float]]:
    """Read the table of objects that `predict` wrote; classes that are merged now become 0."""
    if not present(path):
        return []
    train_ids = {name: i for i, name in enumerate(space.names)}
    made = command("predict", setting("extras", ("objects",)))
    with reading(path) as file, refusing_damage(path, f"a table of `{made}`"):
        table = csv.DictReader(file.read().decode().splitlines())
        boxes = [
            [train_ids.get(row["class"], 0), *(float(row[name]) for name in BOX)] for row in table
        ]
        if not np.isfinite(boxes).all():
            raise ValueError("a number that is not finite")
    return boxes


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Comparison of predicted labels with the labels of the data set."""

    counts: ScanCounts  # Counts of the points, of accepted points if the run rejected labels
    scores: Scores
    uncertainty: UncertaintyEvaluation
    accepted: AcceptedLabels | None  # Coverage and risk of a run that rejected labels
    sentences: list[str]  # Coverage, risk and the guarantee of the run in words


@dataclass(frozen=True, slots=True, eq=False)
class RunResults:
    """Results of a run in numbers per scan."""

    reader: ScanComparison
    rows: Sequence[ScanRow]  # Readable scans, sorted; at least one
    counts: ScanCounts | None  # Of the scans with labels; None without labels
    missing: MissingResults  # Scans without results

    def read(self, row: ScanRow, reason: str = "") -> ShownScan:
        """Read the points of a scan, their results and their confidence."""
        file = row.file
        reader = self.reader
        space = self.reader.space
        truth_in = (reader.labels, space) if reader.has_truth(file) else None
        results = ResultFolder(reader.out).read(file, reader.sensor, space, truth_in)
        path = output_path(reader.out, file.sequence, SOFTMAX, file.stem)
        if present(path):
            all_points = np.ones(len(results.scan), bool)
            softmax = read_softmax(path, all_points, space, reader.merging)
            results.uncertainty["least_confidence"] = lack_of_confidence(softmax)
        boxes = read_boxes(output_path(reader.out, file.sequence, "objects", file.stem), space)
        return ShownScan(name=row.file.name, reason=reason, results=results, boxes=boxes)

    def compared(self) -> Comparison | None:
        """Divide the counts; None without labels."""
        if self.counts is None:
            return None
        counts = self.counts
        space = self.reader.space
        labels = None
        uncertainty = UncertaintyEvaluation.from_counts(counts)
        if counts.accepted:
            labels = AcceptedLabels.from_confusion(counts.confusion, space, counts.accepted)
            counts = replace(counts, confusion=accepted(counts.confusion))
        sentences = list(labels.sentences) if labels else []
        if self.guarantee:
            sentences.append(self.guarantee.sentence)
        return Comparison(
            counts=counts,
            scores=scores(counts.confusion, space),
            uncertainty=uncertainty,
            accepted=labels,
            sentences=sentences,
        )

    @property
    def guarantee(self) -> RiskBoundCheck | None:
        """Guarantee of the accepted labels and their measured risk; None without either."""
        losses = self.counts.accepted if self.counts else {}
        return guarantee_of_run(self.reader.out, self.reader.space, losses)

    def warnings(self) -> Iterator[str]:
        """Yield a line for every reason to doubt the results."""
        if self.guarantee and self.guarantee.warning:
            yield self.guarantee.warning
        if self.counts:
            yield from self.counts.label_warnings(self.reader.space)
            yield from self.reader.warnings()
        names = {name for row in self.rows for name in (row.file.name, row.file.sequence)}
        yield from warnings_of_run(self.reader.out, names)
        if self.missing.scans:
            yield f"{counted(len(self.missing.scans), 'scan')} without results skipped"

    @property
    def judged_points(self) -> str:
        """The points that are right or wrong, in words."""
        return "accepted points with a true class" if self.reader.rejects else "labelled points"

    @property
    def leading_kind(self) -> str | None:
        """First of `LEADING_KINDS` that some scan has, None without any."""
        kinds = set[str]().union(*(row.uncertainty for row in self.rows))
        return next((kind for kind in LEADING_KINDS if kind in kinds), None)

    def notable_scans(self) -> dict[str, str]:
        """Choose the most uncertain, most wrong, worst-class and a random scan; return why."""
        rows = self.rows
        reasons = dict[str, list[str]]()

        def add_largest(values: Sequence[float], reason: Callable[[float], str]) -> None:
            largest = int(np.nan_to_num(values).argmax())
            if values[largest] > 0:
                reasons.setdefault(rows[largest].file.name, []).append(reason(values[largest]))

        kind = self.leading_kind
        if kind:
            means = [row.uncertainty.get(kind, math.nan) for row in rows]
            add_largest(means, lambda mean: f"most uncertain ({mean_in_words(kind, mean)})")
        wrong = [row.wrong for row in rows]
        add_largest(
            wrong, lambda share: f"most wrong ({percentage(share)} of the {self.judged_points})"
        )
        confusions = np.stack([row.confusion for row in rows])
        classes = [c for c in scores(confusions.sum(axis=0), self.reader.space).classes if c.points]
        if classes:
            worst = min(classes, key=lambda c: c.iou)
            i = worst.train_id
            points_of_class = confusions[:, i].sum(axis=1)
            labelled_as_class = confusions[:, :, i].sum(axis=1)
            wrong_points = points_of_class + labelled_as_class - 2 * confusions[:, i, i]
            add_largest(
                wrong_points.tolist(), lambda n: f"worst class: {n:,} points of {worst.name} wrong"
            )
        others = [row for row in rows if row.file.name not in reasons]
        if others:
            # The seed makes the choice reproducible.
            reasons[random.Random(len(rows)).choice(others).file.name] = ["at random"]
        return {name: ", ".join(texts) for name, texts in reasons.items()}

    def scans_by_name(self, names: Sequence[str]) -> dict[str, str]:
        """Choose scans by name, ``08/000000``, or by stem where only one sequence has it."""
        files = [row.file for row in self.rows]
        chosen = named_scans(names, files, argument("scans"))
        return {file.name: "named" for file in chosen}

    def facts(self) -> Iterator[tuple[str, str]]:
        """Yield titles and texts of the recorded settings of the run."""
        yield from recorded_facts(self.reader.out, self.reader.sensor)

    def expected_accuracy(self) -> ExpectedAccuracy | None:
        """Estimate the accuracy of labels of `predict`; None for labels of other stages."""
        out = self.reader.out
        settings = Provenance(out).prediction()
        if settings is None:
            return None
        means = {r.file.name: r.uncertainty.get("least_confidence", math.nan) for r in self.rows}
        confidences = {name: 1 - mean for name, mean in means.items() if not math.isnan(mean)}
        warnings: dict[str, list[str]] = {}
        recorded = OwnedFolder(out, "predict").findings()
        for sequence, stem in find_outputs(out, "predictions"):
            name = f"{sequence}/{stem}"
            for finding in recorded.get(name, ()):
                warnings.setdefault(finding.code, []).append(name)
        return expected_accuracy(settings.accuracy, confidences, warnings)

    def evidence(self) -> Evidence:
        """Return the numbers that decide what to do with the labels.

        After labels were rejected, only warnings decide: the numbers of all labels do not describe
        the accepted ones.
        """
        expected = self.expected_accuracy()
        warned: dict[str, list[str]] = {}
        for name, codes in self.codes.items():
            for code in codes:
                warned.setdefault(code, []).append(name)
        return Evidence(
            scans=len(self.rows),
            class_count=self.reader.space.class_count,
            expected=expected,
            measured=self._measured_accuracy(expected),
            doubtful=None if self.reader.rejects else self.errors.doubtful_share,
            warned=warned,
        )

    def _measured_accuracy(self, expected: ExpectedAccuracy | None) -> float | None:
        """Return the accuracy on labelled scans, 0…1; None if it says nothing about new scans.

        On scans that the weights were trained on, it counts only if it is below the estimate:
        new scans are rarely better.
        """
        counts = self.counts
        if counts is None or counts.accepted:
            return None
        accuracy = scores(counts.confusion, self.reader.space).accuracy
        if math.isnan(accuracy):
            return None
        estimate = expected.accuracy if expected else None
        is_better = estimate is None or accuracy >= estimate
        return None if counts.training_scans and is_better else accuracy

    @property
    def codes(self) -> dict[str, list[str]]:
        """Codes of the warnings about each scan, by its name."""
        return codes_by_scan(self.reader.out, [row.file for row in self.rows])

    @property
    def errors(self) -> PointErrors:
        """Probability of error over the points of all scans."""
        return sum((row.errors for row in self.rows), PointErrors())
