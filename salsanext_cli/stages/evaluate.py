# SPDX-License-Identifier: MIT
"""Compare predictions with labels: scores, a report and plots."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from salsanext_cli import __version__
from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import LabelError, NoInputError, OutputError
from salsanext_cli.formats.atomic import write_text
from salsanext_cli.formats.json_files import read_json, write_json
from salsanext_cli.formats.layout import ScanFile
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.distance import RING_NAMES
from salsanext_cli.measures.scores import Scores, scores
from salsanext_cli.stages.batch import BatchOptions, Failure, run_batch
from salsanext_cli.stages.counting import ScanCounts, count_scan
from salsanext_cli.stages.outputs import as_json, require_same_settings
from salsanext_cli.stages.trust import Trust, trust

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The result of comparing predictions with labels.

    Attributes
    ----------
    space : LabelSpace
        Whose classes were compared.
    confusion : Confusion
        The counts that the scores come from.
    scores : Scores
        Over all points.
    by_distance : dict of str to Scores
        By name of the ring; empty if not wanted.
    unknown_truth, unknown_predictions : dict of int to int
        How often raw ids occur that the label space does not know; taken as unlabelled.
    scans : int
        Number of scans compared.
    missing : tuple of ScanFile
        Scans without predictions, left out.
    failures : tuple of Failure
        Scans that could not be compared, left out.
    settings : dict
        What was chosen and who made the predictions.
    trust : Trust
        How far probabilities and uncertainties can be trusted, if there are any.
    """

    space: LabelSpace
    confusion: Confusion
    scores: Scores
    by_distance: dict[str, Scores]
    unknown_truth: dict[int, int]
    unknown_predictions: dict[int, int]
    scans: int
    missing: tuple[ScanFile, ...]
    failures: tuple[Failure, ...]
    settings: dict[str, Any]
    trust: Trust

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        return {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": self.scans,
            "missing": [str(scan.path) for scan in self.missing],
            "failures": [
                {"scan": str(failure.scan.path), "reason": failure.reason}
                for failure in self.failures
            ],
            "unknown_ids": {
                "truth": {str(i): count for i, count in self.unknown_truth.items()},
                "predictions": {str(i): count for i, count in self.unknown_predictions.items()},
            },
            "scores": self.scores.to_dict(),
            "by_distance": {name: ring.to_dict() for name, ring in self.by_distance.items()},
            "classes": list(self.space.names),
            "confusion": self.confusion.matrix.tolist(),
            **self.trust.to_dict(),
        }


def evaluate(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    options: BatchOptions = BatchOptions(),
    *,
    by_distance: bool = False,
    settings: Mapping[str, Any] | None = None,
) -> Evaluation:
    """Compare the predictions in an output folder with the labels of the scans.

    Writes ``scores.txt`` (as the official evaluator does), ``eval.json`` and pictures,
    ``eval_*.png``, into the output folder. Probabilities and uncertainties that lie there are
    judged too. What an earlier evaluation with the same settings wrote is replaced.

    Parameters
    ----------
    scans : sequence of ScanFile
        What to compare; their labels lie where `ScanFile.label_path` says.
    out : Path
        Output folder of `predict` or `knn-refine`.
    space : LabelSpace
        What the raw ids in both mean.
    options : BatchOptions
        Jobs, errors and progress, and whether a result of other settings is replaced.
    by_distance : bool
        Score rings of distance too, for which the scans are read.
    settings : mapping, optional
        What was chosen and who made the predictions, for the record.

    Raises
    ------
    LabelError
        If a sequence has no labels at all.
    NoInputError
        If there is nothing to compare.
    OutputError
        If the folder holds the result of other settings and may not be overwritten.
    """
    settings = _resolved(settings or {}, by_distance, space)
    if not options.overwrite:
        _require_own_result(out / "eval.json", settings)
    _require_labels(scans)
    work = partial(count_scan, out=out, space=space, by_distance=by_distance)
    counts = ScanCounts.none(space, by_distance)

    def add(of_scan: ScanCounts) -> None:
        nonlocal counts
        counts += of_scan

    outcome = run_batch(work, scans, options, hand_on=add)
    _require_counts(counts, out, outcome.failures)
    evaluation = Evaluation(
        space=space,
        confusion=counts.confusion,
        scores=scores(counts.confusion, space),
        by_distance={
            name: scores(ring, space)
            for name, ring in zip(RING_NAMES, counts.rings, strict=by_distance)
        },
        unknown_truth=dict(sorted(counts.unknown_truth.items())),
        unknown_predictions=dict(sorted(counts.unknown_predictions.items())),
        scans=counts.scans,
        missing=tuple(sorted(counts.missing, key=lambda scan: (scan.sequence, scan.stem))),
        failures=outcome.failures,
        settings=settings,
        trust=trust(counts.uncertainty, counts.scans, space),
    )
    _warn(evaluation)
    _write(evaluation, out)
    return evaluation


def _resolved(settings: Mapping[str, Any], by_distance: bool, space: LabelSpace) -> dict[str, Any]:
    """Return everything that decides what the result is, as it is read back."""
    own = {"by_distance": by_distance, "label_space": space.to_dict()}
    return dict(as_json({**settings, **own}))


def _require_own_result(path: Path, settings: Mapping[str, Any]) -> None:
    """Refuse to replace the result of other settings."""
    earlier = read_json(path)
    if earlier is None:
        return
    remedy = "move it, or use --overwrite to replace it"
    if not isinstance(earlier.get("settings"), dict):
        raise OutputError(path, "not what `eval` writes", remedy=remedy)
    require_same_settings(path, earlier["settings"], settings, remedy)


def _require_labels(scans: Iterable[ScanFile]) -> None:
    """Refuse a sequence without any labels: it is a mistake, not a scan that failed."""
    label_paths = defaultdict(list)
    for scan in scans:
        label_paths[scan.sequence].append(scan.label_path)
    for sequence, paths in label_paths.items():
        if not any(present(path) for path in paths):
            raise LabelError(
                paths[0].parent,
                f"no labels of sequence {sequence}",
                f"files like {paths[0].name}",
                "label them, or leave them out with --split or --sequences",
            )


def _require_counts(counts: ScanCounts, out: Path, failures: Sequence[Failure]) -> None:
    if counts.scans:
        return
    if failures:
        raise NoInputError(out, f"no scan could be compared, as {failures[0].reason}")
    raise NoInputError(
        out,
        f"no predictions for any of {len(counts.missing)} scans",
        "files like sequences/08/predictions/000000.label",
        "run `salsanext predict` first, or say with --out where they are",
    )


def _warn(evaluation: Evaluation) -> None:
    """Say what the figures do not show."""
    unknown = {
        "labels": evaluation.unknown_truth,
        "predictions": evaluation.unknown_predictions,
    }
    for where, ids in unknown.items():
        if ids:
            listed = ", ".join(f"{i} ({count}×)" for i, count in ids.items())
            log.warning("%s: unknown ids %s are taken as unlabelled", where, listed)
    if evaluation.missing:
        first = evaluation.missing[0]
        log.warning(
            "%d of %d scans have no predictions and are left out, the first is %s/%s",
            len(evaluation.missing),
            len(evaluation.missing) + evaluation.scans + len(evaluation.failures),
            first.sequence,
            first.stem,
        )


def _write(evaluation: Evaluation, out: Path) -> None:
    from salsanext_cli.report.plots import confusion_picture, iou_bars

    write_text(out / "scores.txt", evaluation.scores.official_yaml())
    iou_bars(out / "eval_iou.png", evaluation.scores, evaluation.space)
    confusion_picture(out / "eval_confusion.png", evaluation.confusion, evaluation.space)
    evaluation.trust.write_pictures(out)
    write_json(out / "eval.json", evaluation.to_dict())
