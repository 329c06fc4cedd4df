# SPDX-License-Identifier: MIT
"""Stage `compare`: two runs on the same scans, what changed, and whether a change is clear."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.errors import LabelError, NoInputError
from salsanext_cli.core.texts import escaped
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.report.run_changes import changed_scan_picture, comparison_picture
from salsanext_cli.runs.annotation.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.annotation.label_records import pre_labelled_scans
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.scans.selection import MissingResults
from salsanext_cli.runs.summary.run_comparison import (
    CHANGED_SCAN,
    FILES,
    PICTURE,
    RECORD,
    RunComparison,
    run_comparison,
)
from salsanext_cli.runs.summary.run_pair import RunPair, ScanPair

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class CompareOutcome:
    """Comparison of two runs that was written."""

    comparison: RunComparison
    failures: tuple[Failure, ...]  # Scans that could not be compared
    missing: MissingResults  # Scans without labels of both runs


def compare(
    before: Path,
    after: Path,
    *,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> CompareOutcome:
    """Compare the labels of two output folders, and write `FILES` into the second one.

    Parameters
    ----------
    before : Path
        Output folder of the first run.
    after : Path
        Output folder of the second run, with labels of the same scans.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers, progress, and treatment of failures.

    Returns
    -------
    CompareOutcome

    Raises
    ------
    UsageError
        If the runs have other scans or classes, or a run rejected labels.
    LabelError
        If the weights of a run were trained on all scans with true labels.
    """
    paths = [after / name for name in FILES]
    OwnedFolder(after).refuse_foreign(paths)
    runs = _with_usable_labels(RunPair.from_folders(before, after, query))
    pairs: list[ScanPair] = []
    outcome = run_over_scans(
        runs.count, runs.scans, options, on_result=pairs.append, reads=[before, after]
    )
    if not pairs:
        first = outcome.failures[0]
        raise NoInputError(after, f"no scan could be compared: {first.reason}", hint=first.hint)
    _require_other_scans(runs, pairs)
    comparison = run_comparison(pairs, runs)
    for text in (*runs.warnings(), *comparison.warnings()):
        log.warning("%s", text)
    runs.missing.log_error(len(runs.scans) + len(runs.missing.scans), "labels of both runs")
    files = {
        after / RECORD: encode_json(escaped(comparison.to_dict())),
        after / PICTURE: comparison_picture(comparison),
    }
    if comparison.most_changed:
        file = next(scan for scan in runs.scans if scan.name == comparison.most_changed[0].scan)
        files[after / CHANGED_SCAN] = changed_scan_picture(file, comparison.most_changed[0], runs)
    OwnedFolder(after).replace(files, absent=[path for path in paths if path not in files])
    return CompareOutcome(comparison=comparison, failures=outcome.failures, missing=runs.missing)


def _with_usable_labels(runs: RunPair) -> RunPair:
    """Return two runs that are not scored by pre-labels, or labels of another label space."""
    unusable = pre_labelled_scans(runs.scans)
    if warn_of_foreign_labels(runs.scans, runs.labels, runs.sensor):
        unusable = list(runs.scans)
    return replace(runs, unusable=frozenset(scan.name for scan in unusable))


def _require_other_scans(runs: RunPair, pairs: Sequence[ScanPair]) -> None:
    """Refuse scans with true labels that the weights of a run were all trained on."""
    scored = [pair for pair in pairs if pair.sums is not None]
    if scored and all(pair.trained_on for pair in scored):
        problem = "the weights of a run were trained on all scans with labels"
        hint = "predict and compare other scans"
        raise LabelError(runs.after, problem, hint=hint)
