# SPDX-License-Identifier: MIT
"""Stage `eval`: the predictions of a run compared with the labels of its scans."""

import hashlib
import logging
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path

from salsanext_cli.commands.evaluation import Evaluation
from salsanext_cli.commands.jobs.plans.run_plan import RunPlan
from salsanext_cli.commands.score_limits import ScoreLimit, require_classes
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import BAND_NAMES, ScanCounts, SeparateCounts
from salsanext_cli.core.measures.scores import scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.plain_data import Json, as_json
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import present
from salsanext_cli.report.plots import PICTURES
from salsanext_cli.runs.annotation.label_records import require_truth
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.loop.run_options import Shard
from salsanext_cli.runs.results.output_paths import with_outputs
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import space_of_labels
from salsanext_cli.runs.summary.comparison import ScanComparison
from salsanext_cli.runs.summary.guarantee_of_run import guarantee_of_run

FILES = ("scores.txt", *PICTURES, "eval.json")
"""Possible files of an evaluation, which are replaced or removed."""
MAX_PART_BYTES = 100  # Longest name of a folder that lists sequences

log = logging.getLogger(__name__)


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
    chosen = _chosen(out, limits, query)
    return evaluate_scans(
        chosen.scans,
        out,
        chosen.space,
        options,
        chosen.part,
        by_distance=by_distance,
        settings=chosen.results.provenance.recorded_settings(
            query.selection, chosen.results.dataset
        ),
        labels=query.label_space,
    )


def plan_evaluation(
    out: Path,
    *,
    by_distance: bool = False,
    limits: Sequence[ScoreLimit] = (),
    query: ResultQuery = ResultQuery(),
) -> RunPlan:
    """Return what `evaluate` would do with the same arguments; write nothing into `out`.

    Parameters
    ----------
    out, by_distance, limits, query
        As for `evaluate`.

    Returns
    -------
    RunPlan
        All scans with results, and the selected ones with predictions, which are read again by
        every evaluation.

    Raises
    ------
    SalsanextError
        What the run would refuse.
    """
    chosen = _chosen(out, limits, query)
    scans = chosen.scans
    prepared = _prepared(
        scans, out, chosen.space, chosen.part, by_distance=by_distance, labels=query.label_space
    )
    predicted = with_outputs(scans, out, "predictions")
    if not predicted:
        raise _nothing_predicted(out, len(scans))
    results = prepared.results
    missing = results.missing_predictions({*scans} - {*predicted})
    missing.log_error(len(scans), "predictions")
    plan = RunPlan.from_scans(chosen.listed, predicted, Shard(), lambda scan: False)
    return replace(plan, missing=missing)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChosenScans:
    """Scans of an evaluation."""

    results: ResultFolder
    listed: Sequence[ScanFile]  # All scans of the sequences with results
    scans: Sequence[ScanFile]
    space: LabelSpace  # Classes of the comparison
    part: str  # As of `part_of`


def _chosen(out: Path, limits: Sequence[ScoreLimit], query: ResultQuery) -> ChosenScans:
    """Select scans with results; arguments as of `evaluate`."""
    results = ResultFolder(out, query.dataset)
    unlimited = replace(query.selection, limit=None)
    listed = results.scans()
    scans, space = results.selected(listed, unlimited, query.label_space, query.classes)
    require_classes(limits, space)
    return ChosenScans(
        results=results,
        listed=listed,
        scans=scans[: query.selection.limit],
        space=space,
        part=part_of(listed, scans, query.selection),
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
    prepared = _prepared(scans, out, space, part, by_distance=by_distance, labels=labels)
    comparison = prepared.comparison
    recorded = {**(settings or {}), "by_distance": by_distance, "label_space": space}
    if comparison.labels.learning_map != space.learning_map:
        recorded["label_space_of_labels"] = comparison.labels
    folder = prepared.folder
    evaluation = _evaluation(
        prepared.results, comparison, scans, options, as_json(recorded), folder
    )
    for text in evaluation.warnings():
        log.warning("%s", text)
    evaluation.missing.log_error(len(scans), "predictions")
    paths = prepared.paths
    files = {folder / name: content for name, content in evaluation.files().items()}
    OwnedFolder(out).replace(files, absent=[path for path in paths if path not in files])
    return evaluation


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedEvaluation:
    """Evaluation before its first scan."""

    results: ResultFolder
    folder: Path  # Receives the files
    comparison: ScanComparison

    @property
    def paths(self) -> list[Path]:
        """All possible files of the evaluation."""
        return [self.folder / name for name in FILES]


def _prepared(
    scans: Sequence[ScanFile],
    out: Path,
    space: LabelSpace,
    part: str,
    *,
    by_distance: bool,
    labels: LabelSpace | None,
) -> PreparedEvaluation:
    """Refuse what cannot be evaluated; arguments as of `evaluate_scans`."""
    results = ResultFolder(out)
    folder = out / "eval" / part if part else out
    OwnedFolder(out).refuse_foreign(folder / name for name in FILES)
    _require_labels(scans)
    labels = space_of_labels(scans, space, labels)
    comparison = ScanComparison.from_results(
        results.provenance, space, labels, by_distance=by_distance
    )
    return PreparedEvaluation(results=results, folder=folder, comparison=comparison)


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
    outcome = run_over_scans(
        comparison.count, scans, options, on_result=separate.add, reads=[results.root]
    )
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
    return _nothing_predicted(out, len(counts.missing))


def _nothing_predicted(out: Path, count: int) -> NoInputError:
    """Return the error about so many scans without predictions."""
    problem = f"has no predictions of {counted(count, 'scan')}"
    hint = "run `salsanext predict` first, or give their folder: salsanext eval OUT"
    return NoInputError(out, problem, hint=hint)


def part_of(
    listed: Sequence[ScanFile], chosen: Sequence[ScanFile], selection: ScanSelection
) -> str:
    """Return a name for a part of the scans with results, such as ``08,10-first-5``.

    Parameters
    ----------
    listed : sequence of ScanFile
        All scans of the sequences with results.
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
    total = chosen if selection.split else listed
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
