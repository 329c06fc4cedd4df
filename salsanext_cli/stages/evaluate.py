# SPDX-License-Identifier: MIT
"""Evaluation of predictions against labels: scores, a report and plots."""

import hashlib
import logging
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import LabelError, NoInputError, counted, escaped
from salsanext_cli.files.json_files import Json, as_json, encode_json, plain
from salsanext_cli.files.reading import present
from salsanext_cli.labelling.label_records import require_truth
from salsanext_cli.measures.panoptic import panoptic_quality
from salsanext_cli.measures.risk_control import RISK_BOUND_EXCEEDED, KeptLabels, RiskBoundCheck
from salsanext_cli.measures.scan_counts import BAND_NAMES, CountsApart, ScanComparison, ScanCounts
from salsanext_cli.measures.scores import Scores, band_rows, scores
from salsanext_cli.measures.uncertainty_evaluation import (
    UncertaintyEvaluation,
    evaluate_uncertainty,
)
from salsanext_cli.option_fields import ScanSelection
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.report.plots import PICTURES, evaluation_pictures
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import MissingResults, space_of_labels
from salsanext_cli.version import __version__

FILES = ("scores.txt", *PICTURES, "eval.json")  # An evaluation may write these
MAX_PART_BYTES = 100  # Longest list of sequences that names a folder
ON_TRAINING_SCANS = "scores on scans that the weights were trained on"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Result of comparing predictions with labels."""

    space: LabelSpace  # Classes of the comparison
    counts: ScanCounts  # Of the scans compared: all if the weights were trained on every one
    scores: Scores  # Scores over all points
    by_distance: dict[str, Scores]  # Scores by name of the band; empty if not requested
    missing: MissingResults  # Scans without predictions, left out
    failures: tuple[Failure, ...]  # Scans that could not be compared, left out
    settings: dict[str, object]  # Settings of the evaluation and of the predictions
    # Results for the probabilities and uncertainties, if there are any
    uncertainty: UncertaintyEvaluation
    kept: KeptLabels | None  # Coverage and risk of the labels of a run that rejected some
    promise: RiskBoundCheck | None  # What its threshold promised, if that came with the weights
    folder: Path  # Where it is written
    by_sequence: dict[str, Scores]
    # Panoptic quality, if objects were predicted and the labels have instances
    panoptic: Json | None

    @property
    def object_sentence(self) -> str:
        """Panoptic quality of the objects in words."""
        means = (self.panoptic or {}).get("things_present", {}).items()
        qualities = ", ".join(f"{name.upper()} {100 * share:.1f} %" for name, share in means)
        return f"Objects, mean of the classes present: {qualities}."

    def log_warnings(self) -> None:
        """Log what the scores do not tell, or may tell wrongly."""
        for text in self.counts.label_warnings(self.space):
            log.warning("%s", text)
        if self.promise and self.promise.is_exceeded:
            log.warning("%s", RISK_BOUND_EXCEEDED)
        compared = self.counts.scans + len(self.failures) + len(self.counts.missing)
        self.missing.log_error(compared, "predictions")

    def files(self) -> dict[str, bytes]:
        """Return the content of the files of an evaluation by name."""
        heading = f"# {ON_TRAINING_SCANS}\n" if self.counts.trained_on else ""
        return {
            "scores.txt": (heading + self.scores.official_yaml()).encode(),
            **evaluation_pictures(self.scores, self.counts.confusion, self.uncertainty, self.space),
            "eval.json": encode_json(escaped(self.to_dict())),
        }

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; null stands for NaN."""
        counts = self.counts
        unknown_ids = {"truth": counts.unknown_truth, "predictions": counts.unknown_predictions}
        content = {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": counts.scans,
            "trained_on": counts.left_out,
            "on_training_scans": counts.trained_on > 0,
            **self.missing.to_dict(),
            "failures": self.failures,
            "unknown_ids": {name: dict(sorted(ids.items())) for name, ids in unknown_ids.items()},
            "scores": self.scores,
            "by_distance": {
                name: plain(band) | {"iou_mean_same": mean, "absent": absent}
                for name, band, mean, absent in band_rows(self.by_distance)
            },
            "by_sequence": self.by_sequence,
            "by_scan": dict(sorted(counts.by_scan.items())),
            **({"panoptic": self.panoptic} if self.panoptic else {}),
            "classes": self.space.names,
            "confusion": counts.confusion,
            **self.uncertainty.to_json(self.space),
            "rejection": self.kept and plain(self.kept) | {"promise": self.promise},
        }
        return dict(plain(content))


def evaluate(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    options: RunOptions = RunOptions(),
    part: str = "",
    *,
    by_distance: bool = False,
    settings: dict[str, object] | None = None,
    labels: LabelSpace | None = None,
) -> Evaluation:
    """Compare the predictions in an output folder with the labels of the scans.

    Writes `FILES`, in the place of earlier ones, into the folder or, of a part of the scans, into
    ``eval/PART``. Scans that the weights were trained on are left out, unless all were.
    `space`: classes to compare; `settings`: for the record; `labels`: as of `space_of_labels`.
    """
    folder = out / "eval" / part if part else out
    results = ResultFolder(out)
    labels = space_of_labels(scans, space, labels)
    own_files = [folder / name for name in FILES]
    OwnedFolder(out).require_own(own_files)
    _require_labels(scans)
    recorded, promised = results.settings_of("predictions"), results.promised(space)
    # Those of other programs may have instances.
    comparison = replace(
        ScanComparison.of_results(results, space, labels, by_distance=by_distance),
        objects=recorded is None or bool(recorded.objects),
    )
    counts, failures = _counted(comparison, scans, options)
    panoptic = None
    if counts.segments[:, -1].any() and not space.movable.any():
        log.warning("no panoptic quality: %s states no movable classes", space.name)
    elif counts.segments[:, -1].any():
        panoptic = panoptic_quality(counts.segments, space, space.movable)
    bands = zip(BAND_NAMES, counts.bands, strict=by_distance)
    compared_in = {"by_distance": by_distance, "label_space": space}
    if labels.learning_map != space.learning_map:
        compared_in["label_space_of_labels"] = labels
    evaluation = Evaluation(
        space=space,
        counts=counts,
        scores=scores(counts.confusion, space),
        by_distance={name: scores(band, space) for name, band in bands},
        missing=results.missing_predictions(counts.missing),
        failures=failures,
        settings=as_json({**(settings or {}), **compared_in}),
        uncertainty=evaluate_uncertainty(counts, space),
        folder=folder,
        by_sequence={name: scores(c, space) for name, c in sorted(counts.by_sequence.items())},
        panoptic=panoptic,
        kept=KeptLabels.of_confusion(counts.confusion, space, counts.kept) if counts.kept else None,
        promise=RiskBoundCheck.of_scans(promised, counts.kept) if promised else None,
    )
    evaluation.log_warnings()
    files = {folder / name: content for name, content in evaluation.files().items()}
    absent = [path for path in own_files if path not in files]
    OwnedFolder(out).replace(files, absent)
    return evaluation


def _counted(
    comparison: ScanComparison, scans: Sequence[ScanFile], options: RunOptions
) -> tuple[ScanCounts, tuple[Failure, ...]]:
    """Count scans, but those that the weights were trained on unless all were; name failures."""
    apart = CountsApart(comparison.space, comparison.by_distance)
    outcome = run_over_scans(comparison.count, scans, options, on_result=apart.add)
    counts, out = apart.scored(), comparison.out
    if not counts.scans:
        if outcome.failures:
            raise NoInputError(out, f"no scan could be compared, as {outcome.failures[0].reason}")
        found = f"no predictions for any of {counted(len(counts.missing), 'scan')}"
        hint = "run `salsanext predict` first, or say where they are: salsanext eval OUT"
        raise NoInputError(out, found, hint=hint)
    return counts, outcome.failures


def part_of(folder: ResultFolder, scans: Sequence[ScanFile], selection: ScanSelection) -> str:
    """Name a part of the scans with results, as in ``08,10-first-5``; all are no part."""
    limit, every = selection.limit, folder.scans()
    if selection.split:
        every, _ = folder.predicted(ScanSelection(selection.split))
    name = ",".join(sorted({scan.sequence for scan in scans}))
    if len(os.fsencode(name)) > MAX_PART_BYTES:
        digest = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
        name = f"{name.count(',') + 1} sequences {digest}"
    name += f"-first-{limit}" * bool(limit)
    chosen = bool(selection.sequences or limit) and len(scans) < len(every)
    return name if chosen else ""


def _require_labels(scans: Sequence[ScanFile]) -> None:
    """Refuse a sequence without any labels, which is no failure of single scans."""
    require_truth(scans)
    for sequence, members in groupby(scans, lambda scan: scan.sequence):
        paths = [scan.label_path for scan in members]
        if not any(present(path) for path in paths):
            found, expected = f"no labels of sequence {sequence}", f"files like {paths[0].name}"
            hint = "label them, or leave them out with --split or --sequences"
            raise LabelError(paths[0].parent, found, expected, hint)
