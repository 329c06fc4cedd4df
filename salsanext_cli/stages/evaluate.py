# SPDX-License-Identifier: MIT
"""Evaluation of predictions against labels: scores, a report and plots."""

import hashlib
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import LabelError, NoInputError, counted, escaped
from salsanext_cli.files.json_files import encode_json
from salsanext_cli.files.reading import present
from salsanext_cli.labelling.label_records import require_truth
from salsanext_cli.measures.panoptic import panoptic_quality
from salsanext_cli.measures.risk_control import RISK_BOUND_EXCEEDED, KeptLabels, RiskBoundCheck
from salsanext_cli.measures.scan_counts import BAND_NAMES, CountsApart, ScanCounts, count_scan
from salsanext_cli.measures.scores import Scores, band_rows, plain, scores
from salsanext_cli.measures.uncertainty_evaluation import (
    UncertaintyEvaluation,
    evaluate_uncertainty,
)
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.report.plots import PICTURES, evaluation_pictures
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import MissingResults, space_of_labels
from salsanext_cli.results.stage_records import as_json
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
    settings: dict[str, Any]  # Settings of the evaluation and of the predictions
    # Results for the probabilities and uncertainties, if there are any
    uncertainty: UncertaintyEvaluation
    kept: KeptLabels | None  # Coverage and risk of the labels of a run that rejected some
    promise: RiskBoundCheck | None  # What its threshold promised, if that came with the weights
    folder: Path  # Where it is written
    by_sequence: dict[str, Scores]
    # Panoptic quality, if objects were predicted and the labels have instances
    panoptic: dict[str, Any] | None

    @property
    def object_sentence(self) -> str:
        """Panoptic quality of the objects in words."""
        means = (self.panoptic or {}).get("things_present", {}).items()
        qualities = ", ".join(f"{name.upper()} {100 * share:.1f} %" for name, share in means)
        return f"Objects, mean of the classes present: {qualities}."

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        counts = self.counts
        unknown_ids = {"truth": counts.unknown_truth, "predictions": counts.unknown_predictions}
        return {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": counts.scans,
            "trained_on": counts.left_out,
            "on_training_scans": counts.trained_on > 0,
            **self.missing.to_dict(),
            "failures": [failure.to_dict() for failure in self.failures],
            "unknown_ids": {name: dict(sorted(ids.items())) for name, ids in unknown_ids.items()},
            "scores": self.scores.to_dict(),
            "by_distance": {
                name: band.to_dict() | {"iou_mean_same": plain(mean), "absent": absent}
                for name, band, mean, absent in band_rows(self.by_distance)
            },
            "by_sequence": {name: each.to_dict() for name, each in self.by_sequence.items()},
            "by_scan": dict(sorted(counts.by_scan.items())),
            **({"panoptic": self.panoptic} if self.panoptic else {}),
            "classes": list(self.space.names),
            "confusion": counts.confusion.tolist(),
            **self.uncertainty.to_dict(self.space),
            "rejection": self.kept
            and asdict(self.kept) | {"promise": self.promise and asdict(self.promise)},
        }


def evaluate(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    options: RunOptions = RunOptions(),
    part: str = "",
    *,
    by_distance: bool = False,
    settings: Mapping[str, Any] | None = None,
    labels: LabelSpace | None = None,
) -> Evaluation:
    """Compare the predictions in an output folder with the labels of the scans.

    Writes `FILES`, in the place of earlier ones, into the folder or, of a part of the scans, into
    ``eval/PART``. Scans that the weights were trained on are left out, unless all were.
    `space`: classes to compare; `settings`: for the record; `labels`: as of `space_of_labels`.
    """
    folder = out / "eval" / part if part else out
    results = ResultFolder(out)
    labels, merging = space_of_labels(scans, space, labels), results.merging_into(space)
    own = {"by_distance": by_distance, "label_space": space.to_dict()}
    if labels.learning_map != space.learning_map:
        own["label_space_of_labels"] = labels.to_dict()
    settings = dict(as_json({**(settings or {}), **own}))
    own_files = [folder / name for name in FILES]
    OwnedFolder(out).require_own(own_files)
    _require_labels(scans)
    apart = CountsApart(space, by_distance)
    recorded, promised = results.settings_of("predictions"), results.promised(space)
    # Those of other programs may have instances.
    objects = recorded is None or bool(recorded.get("objects"))
    count = partial(count_scan, out=out, space=space, labels=labels, merging=merging)
    count = partial(count, by_distance=by_distance, sensor=results.sensor(), objects=objects)
    count = partial(count, trained_on=results.trained_on(), rejection=results.rejection())
    outcome = run_over_scans(count, scans, options, on_result=apart.add)
    counts = apart.scored()
    if not counts.scans:
        if outcome.failures:
            raise NoInputError(out, f"no scan could be compared, as {outcome.failures[0].reason}")
        found = f"no predictions for any of {counted(len(counts.missing), 'scan')}"
        remedy = "run `salsanext predict` first, or say where they are: salsanext eval OUT"
        raise NoInputError(out, found, remedy=remedy)
    panoptic = None
    if counts.segments[:, -1].any():
        panoptic = panoptic_quality(counts.segments, space, space.movable)
    bands = zip(BAND_NAMES, counts.bands, strict=by_distance)
    evaluation = Evaluation(
        space=space,
        counts=counts,
        scores=scores(counts.confusion, space),
        by_distance={name: scores(band, space) for name, band in bands},
        missing=results.missing_predictions(counts.missing),
        failures=outcome.failures,
        settings=settings,
        uncertainty=evaluate_uncertainty(counts, space),
        folder=folder,
        by_sequence={name: scores(c, space) for name, c in sorted(counts.by_sequence.items())},
        panoptic=panoptic,
        kept=KeptLabels.of_confusion(counts.confusion, space, counts.kept) if counts.kept else None,
        promise=RiskBoundCheck.of_scans(promised, counts.kept) if promised else None,
    )
    for text in counts.label_warnings(space):
        log.warning("%s", text)
    if evaluation.promise and evaluation.promise.is_exceeded:
        log.warning("%s", RISK_BOUND_EXCEEDED)
    compared = counts.scans + len(evaluation.failures) + len(counts.missing)
    evaluation.missing.log_error(compared, "predictions")
    heading = f"# {ON_TRAINING_SCANS}\n" if counts.trained_on else ""
    files = {
        "scores.txt": (heading + evaluation.scores.official_yaml()).encode(),
        **evaluation_pictures(evaluation.scores, counts.confusion, evaluation.uncertainty, space),
        "eval.json": encode_json(escaped(evaluation.to_dict())),
    }
    absent = [path for path in own_files if path.name not in files]
    OwnedFolder(out).replace({folder / name: content for name, content in files.items()}, absent)
    return evaluation


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
            remedy = "label them, or leave them out with --split or --sequences"
            raise LabelError(paths[0].parent, found, expected, remedy)
