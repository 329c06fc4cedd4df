# SPDX-License-Identifier: MIT
"""Evaluation of predictions against labels: scores, a report and plots."""

import hashlib
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.commands.score_limits import (
    MissedLimit,
    ScoreLimit,
    missed_limits,
    require_classes,
    score_values,
)
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import BAND_NAMES, ScanCounts, SeparateCounts
from salsanext_cli.core.measures.risk_control import CONSECUTIVE, RiskBoundCheck
from salsanext_cli.core.measures.scores import Scores, band_scores, scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.plain_data import Json, as_json, plain
from salsanext_cli.core.texts import counted, escaped
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.io.files.reading import present
from salsanext_cli.report.plots import PICTURES, confusion_picture, uncertainty_pictures
from salsanext_cli.runs.labelling.label_records import require_truth
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.results.selection import MissingResults, space_of_labels
from salsanext_cli.runs.summary.comparison import ScanComparison
from salsanext_cli.runs.summary.scan_summary import NOT_COMPARED, TUNE_AGAIN, guarantee_of_run
from salsanext_cli.version import __version__

FILES = ("scores.txt", *PICTURES, "eval_iou.png", "eval.json")
"""Possible files of an evaluation, also of version 0.9.0, which are replaced or removed."""
MAX_PART_BYTES = 100  # Longest name of a folder that lists sequences
NOT_COVERED = (
    "the guarantee does not cover these scans: `predict` found that they differ from those that "
    f"the threshold was chosen on ({WarningCode.OTHER_SCANS})\nhint: {TUNE_AGAIN}"
)
ON_TRAINING_SCANS = "scores on scans that the weights were trained on"
UNKNOWN_TRAINING_SCANS = "scores on scans that the weights may have been trained on"

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Result of comparing predictions with labels."""

    space: LabelSpace  # Classes of the comparison
    comparison: ScanComparison
    counts: ScanCounts  # Of the scored scans: all only if the weights were trained on all
    scores: Scores  # Scores over all points
    by_distance: dict[str, Scores]  # Scores by name of the band; empty if not requested
    missing: MissingResults  # Skipped scans without predictions
    failures: tuple[Failure, ...]  # Skipped scans that could not be compared
    settings: dict[str, object]  # Settings of the evaluation and of the predictions
    uncertainty: UncertaintyEvaluation  # Results for probabilities and uncertainties, if any
    accepted: AcceptedLabels | None  # Coverage and risk of a run that rejected labels
    guarantee: RiskBoundCheck | None  # Check of the guarantee of `tune risk`, if the run used it
    folder: Path  # Folder of the files
    by_sequence: dict[str, Scores]

    def files(self) -> dict[str, bytes]:
        """Return the content of the files of an evaluation by name."""
        heading = f"# {self.doubt}\n" if self.doubt else ""
        return {
            "scores.txt": (heading + self.scores.official_yaml()).encode(),
            "eval_confusion.png": confusion_picture(self.counts.confusion, self.space),
            **uncertainty_pictures(self.uncertainty),
            "eval.json": encode_json(escaped(self.to_dict())),
        }

    @property
    def doubt(self) -> str:
        """Whether the weights were or may have been trained on the scans, in words; else empty."""
        if self.comparison.trained_on.missing:
            return UNKNOWN_TRAINING_SCANS
        return ON_TRAINING_SCANS if self.counts.trained_on else ""

    @property
    def guarantee_doubt(self) -> str:
        """Why the scans do not test the guarantee of the run, in words; else empty."""
        if self.counts.calibrated:
            return "the threshold was chosen on some of these scans"
        if self.comparison.chosen_on.missing:
            return "the record of the scans that the threshold was chosen on is missing"
        if self.guarantee and self.guarantee.are_others:
            return f"the guarantee does not cover these scans ({WarningCode.OTHER_SCANS})"
        if self.guarantee and self.guarantee.consecutive:
            return f"{CONSECUTIVE} ({WarningCode.CONSECUTIVE})"
        if self.guarantee and self.guarantee.incomparable:
            reason = self.guarantee.incomparable
            return f"{NOT_COMPARED} ({reason})"
        return ""

    def missed_limits(self, limits: Sequence[ScoreLimit]) -> list[MissedLimit]:
        """Return the limits that the scores do not keep to."""
        values = score_values(self.scores, self.uncertainty, self.accepted)
        return missed_limits(limits, values, self.guarantee, self.guarantee_doubt)

    def warnings(self) -> Iterator[str]:
        """Yield reasons to doubt the scores or the guarantee, in words."""
        yield from self.counts.label_warnings(self.space)
        yield from self.comparison.warnings()
        if self.guarantee and self.guarantee.warning:
            yield self.guarantee.warning
        elif self.guarantee and self.guarantee.are_others:
            yield NOT_COVERED

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; null stands for NaN."""
        counts = self.counts
        is_known = self.comparison.trained_on.missing is None
        unknown_ids = {"truth": counts.unknown_truth, "predictions": counts.unknown_predictions}
        content = {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": counts.scans,
            "trained_on": counts.skipped if is_known else None,
            "on_training_scans": counts.trained_on > 0 if is_known else None,
            **self.missing.to_dict(),
            "failures": self.failures,
            "unknown_ids": {name: dict(sorted(ids.items())) for name, ids in unknown_ids.items()},
            "scores": self.scores,
            "by_distance": {
                band.name: plain(band.scores)
                | {"iou_mean_same": band.iou_mean_same, "absent": band.absent}
                for band in band_scores(self.by_distance)
            },
            "by_sequence": self.by_sequence,
            "by_scan": dict(sorted(counts.by_scan.items())),
            "classes": self.space.names,
            "confusion": counts.confusion,
            **self.uncertainty.to_json(),
            "rejection": self.accepted and plain(self.accepted) | {"guarantee": self.guarantee},
        }
        return dict(plain(content))


def evaluate(
    out: Path,
    *,
    by_distance: bool = False,
    limits: Sequence[ScoreLimit] = (),
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Evaluation:
    """Compare the predictions in an output folder with the labels of their scans.

    Parameters
    ----------
    out : Path
        Folder with predictions.
    by_distance : bool
        Whether to score distance bands too.
    limits : sequence of ScoreLimit
        Limits on the scores, whose classes must be scored.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures.

    Returns
    -------
    Evaluation
    """
    results = ResultFolder(out, query.dataset)
    unlimited = replace(query.selection, limit=None)
    scans, space = results.predicted(unlimited, query.label_space, query.classes)
    require_classes(limits, space)
    return evaluate_scans(
        scans[: query.selection.limit],
        out,
        space,
        options,
        part_of(results, scans, query.selection),
        by_distance=by_distance,
        settings=results.provenance(query.selection),
        labels=query.label_space,
    )


def evaluate_scans(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    options: RunOptions = RunOptions(),
    part: str = "",
    *,
    by_distance: bool = False,
    settings: Mapping[str, object] | None = None,
    labels: LabelSpace | None = None,
) -> Evaluation:
    """Compare the predictions of some scans in an output folder with their labels.

    Replace `FILES` in the folder, or in ``eval/PART`` for a part of the scans. Scans that the
    weights were trained on are skipped, unless the weights were trained on all.

    Parameters
    ----------
    scans : sequence of ScanFile
        Scans to compare.
    out : Path
        Output folder with predictions.
    space : LabelSpace
        Classes of the comparison.
    options : RunOptions, optional
        Workers, and the reaction to errors.
    part : str, optional
        Name of the part of the scans, as of `part_of`.
    by_distance : bool, optional
        Whether to score distance bands too.
    settings : mapping, optional
        Further settings for the record.
    labels : LabelSpace, optional
        Label space of the labels, by default that of the data set.

    Returns
    -------
    Evaluation
    """
    folder = out / "eval" / part if part else out
    paths = [folder / name for name in FILES]
    OwnedFolder(out).refuse_foreign(paths)
    _require_labels(scans)
    labels = space_of_labels(scans, space, labels)
    recorded = {**(settings or {}), "by_distance": by_distance, "label_space": space}
    if labels.learning_map != space.learning_map:
        recorded["label_space_of_labels"] = labels
    results = ResultFolder(out)
    comparison = ScanComparison.from_results(
        results.manifest, space, labels, by_distance=by_distance
    )
    evaluation = _evaluation(results, comparison, scans, options, as_json(recorded), folder)
    for text in evaluation.warnings():
        log.warning("%s", text)
    counts = evaluation.counts
    compared = counts.scans + len(evaluation.failures) + len(counts.missing)
    evaluation.missing.log_error(compared, "predictions")
    files = {folder / name: content for name, content in evaluation.files().items()}
    OwnedFolder(out).replace(files, absent=[path for path in paths if path not in files])
    return evaluation


def _evaluation(
    results: ResultFolder,
    comparison: ScanComparison,
    scans: Sequence[ScanFile],
    options: RunOptions,
    settings: Json,
    folder: Path,
) -> Evaluation:
    """Count the scans and divide the counts."""
    space = comparison.space
    separate = SeparateCounts(space, comparison.by_distance)
    outcome = run_over_scans(comparison.count, scans, options, on_result=separate.add)
    counts = separate.scored()
    if not counts.scans:
        raise _nothing_compared(results.root, counts, outcome.failures)
    accepted = None
    if counts.accepted:
        accepted = AcceptedLabels.from_confusion(counts.confusion, space, counts.accepted)
    bands = zip(BAND_NAMES, counts.bands, strict=comparison.by_distance)
    return Evaluation(
        space=space,
        comparison=comparison,
        counts=counts,
        scores=scores(counts.confusion, space),
        by_distance={name: scores(band, space) for name, band in bands},
        missing=results.missing_predictions(
            [scan for scan in scans if scan.name in counts.missing]
        ),
        failures=outcome.failures,
        settings=settings,
        uncertainty=UncertaintyEvaluation.from_counts(counts),
        folder=folder,
        by_sequence={
            name: scores(confusion, space) for name, confusion in sorted(counts.by_sequence.items())
        },
        accepted=accepted,
        guarantee=guarantee_of_run(results.root, space, counts.accepted),
    )


def _nothing_compared(out: Path, counts: ScanCounts, failures: Sequence[Failure]) -> NoInputError:
    """Return the error about scans of which none could be compared."""
    if failures:
        problem = f"no scan could be compared: {failures[0].reason}"
        return NoInputError(out, problem, hint=failures[0].hint)
    problem = f"has no predictions of {counted(len(counts.missing), 'scan')}"
    hint = "run `salsanext predict` first, or give their folder: salsanext eval OUT"
    return NoInputError(out, problem, hint=hint)


def part_of(folder: ResultFolder, chosen: Sequence[ScanFile], selection: ScanSelection) -> str:
    """Return a name for a part of the scans with results, such as ``08,10-first-5``.

    Parameters
    ----------
    folder : ResultFolder
        Output folder.
    chosen : sequence of ScanFile
        Scans of the selected split or sequences, whatever the limit.
    selection : ScanSelection
        Selection by split, sequences and limit.

    Returns
    -------
    str
        Name of the part, empty for all scans of the split or folder.
    """
    limit = selection.limit
    scans = chosen[:limit]
    total = chosen if selection.split else folder.scans()
    name = ",".join(sorted({scan.sequence for scan in scans}))
    if len(os.fsencode(name)) > MAX_PART_BYTES:
        digest = hashlib.sha256(os.fsencode(name)).hexdigest()[:16]
        name = f"{name.count(',') + 1} sequences {digest}"
    if limit:
        name = f"{name}-first-{limit}"
    is_part = bool(selection.sequences or limit) and len(scans) < len(total)
    return name if is_part else ""


def _require_labels(scans: Sequence[ScanFile]) -> None:
    """Refuse a sequence without any labels."""
    require_truth(scans)
    for sequence, members in groupby(scans, lambda scan: scan.sequence):
        paths = [scan.label_path for scan in members]
        if not any(present(path) for path in paths):
            problem = f"has no labels of sequence {sequence}"
            others = f"{argument('split')} or {argument('sequences')}"
            hint = f"label its scans, or choose others with {others}"
            raise LabelError(paths[0].parent, problem, f"files like {paths[0].name}", hint)
