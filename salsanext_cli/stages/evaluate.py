# SPDX-License-Identifier: MIT
"""Compare predictions with labels: scores, a report and plots."""

from __future__ import annotations

import logging
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import LabelError, NoInputError, OutputError
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.distance import RING_NAMES
from salsanext_cli.measures.evaluation import Evaluation
from salsanext_cli.measures.scan_counts import ScanCounts, count_scan
from salsanext_cli.measures.scores import scores
from salsanext_cli.measures.uncertainty_evaluation import trust
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.storage.atomic import write_text
from salsanext_cli.storage.json_files import read_json, write_json
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.run_registration import records_lock
from salsanext_cli.storage.sources import missing_predictions
from salsanext_cli.storage.stage_records import as_json, require_same_settings

log = logging.getLogger(__name__)


def evaluate(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    options: RunOptions = RunOptions(),
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

    outcome = run_over_scans(work, scans, options, on_result=add)
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
        absent=missing_predictions(out, counts.missing),
        failures=outcome.failures,
        settings=settings,
        trust=trust(counts.uncertainty, counts.scans, space),
    )
    _warn(evaluation)
    with records_lock(out):
        if not options.overwrite:
            _require_own_result(out / "eval.json", settings)
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
    scans = evaluation.scans + len(evaluation.failures) + len(evaluation.absent.missing)
    evaluation.absent.log_error(scans + evaluation.absent.not_asked_for, "predictions")


def _write(evaluation: Evaluation, out: Path) -> None:
    from salsanext_cli.report.plots import confusion_picture, iou_bars

    write_text(out / "scores.txt", evaluation.scores.official_yaml())
    iou_bars(out / "eval_iou.png", evaluation.scores, evaluation.space)
    confusion_picture(out / "eval_confusion.png", evaluation.confusion, evaluation.space)
    evaluation.trust.write_pictures(out)
    write_json(out / "eval.json", evaluation.to_dict())
