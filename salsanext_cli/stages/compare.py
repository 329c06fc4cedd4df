# SPDX-License-Identifier: MIT
"""Stage `compare`: two runs on the same scans, what changed, and whether it is better."""

import logging
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import (
    LabelError,
    NoInputError,
    UsageError,
    counted,
    escaped,
    first_few,
)
from salsanext_cli.files.json_files import encode_json
from salsanext_cli.files.reading import present
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.measures.paired import RunComparison, ScanPair
from salsanext_cli.measures.scan_counts import ScanComparison, ScanCounts
from salsanext_cli.measures.scores import class_sums, confusion_matrix, scored_rows
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile, output_path, with_outputs
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import space_of_labels
from salsanext_cli.sensors.sensor import Sensor

RECORD = "compare.json"

log = logging.getLogger(__name__)


def compare(
    before: Path,
    after: Path,
    *,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> tuple[RunComparison, tuple[Failure, ...]]:
    """Compare two output folders; write `compare.json` into the second one.

    Parameters
    ----------
    before, after : Path
        Output folders of the first and of the second run.
    query : ResultQuery, optional
        Scans to compare, and their classes.
    options : RunOptions, optional
        Workers, and the reaction to errors.

    Returns
    -------
    RunComparison
        Scores of both runs, their differences, and changed labels.
    tuple of Failure
        Scans that could not be compared.
    """
    if before.resolve() == after.resolve():
        raise UsageError("OUT_B", f"{after} is OUT_A too", "the folder of another run")
    runs = ResultFolder(before, query.dataset), ResultFolder(after, query.dataset)
    OwnedFolder(after).refuse_foreign([after / RECORD])
    both, alone, space = _common_scans(runs, query)
    sensor, labels = runs[0].sensor(), space_of_labels(both, space, query.label_space)
    trained_on = runs[0].trained_on() | runs[1].trained_on()
    of_before, of_after = (
        replace(
            ScanComparison.of_results(run, space, labels, by_distance=False),
            sensor=sensor,
            rejection=None,
            trained_on=trained_on,
        )
        for run in runs
    )
    pairs, failures = _compared(both, (of_before, of_after), options)
    rejecting = any(run.rejection() for run in runs)
    result = RunComparison(space, sorted(pairs, key=lambda pair: pair.file), rejecting)
    content = {"stage": "compare", "before": str(before), "after": str(after), "alone": alone}
    content |= {"weights": [run.weights("predictions") for run in runs], **result.to_dict()}
    OwnedFolder(after).replace({after / RECORD: encode_json(escaped(content))})
    return result, failures


def _common_scans(
    runs: tuple[ResultFolder, ResultFolder], query: ResultQuery
) -> tuple[list[ScanFile], int, LabelSpace]:
    """Return the scans with labels of both runs, the number of other scans, and the classes."""
    before, after = (run.root for run in runs)
    (scans, space), (other_scans, other_space) = (
        run.predicted(query.selection, query.label_space, query.classes) for run in runs
    )
    if not space.fits(other_space):
        problem = f"has other classes than {before} ({first_few(space.differences(other_space))})"
        raise UsageError(after, problem, hint="merge both with --classes coarse")
    of_before, of_after = (
        {scan.name: scan for scan in with_outputs(chosen, run.root, "predictions")}
        for chosen, run in zip((scans, other_scans), runs, strict=True)
    )
    both = [scan for name, scan in of_before.items() if name in of_after]
    if not both:
        raise NoInputError(after, f"has no labels of the scans of {before}")
    for _, members in groupby(both, lambda scan: scan.sequence):
        _require_same(first := next(members), of_after[first.name], runs[0].sensor())
    if alone := len(of_before.keys() ^ of_after):
        log.warning("%s skipped, with labels of one run only", counted(alone, "scan"))
    return both, alone, space


def _require_same(scan: ScanFile, other: ScanFile, sensor: Sensor) -> None:
    """Refuse two files of a scan with different points."""
    if scan.path == other.path:
        return
    points, others = (read_scan(file.path, sensor).points for file in (scan, other))
    if not np.array_equal(points, others, equal_nan=True):
        hint = "compare runs on the same scans"
        raise UsageError(other.path, f"has other points than {scan.path}", hint=hint)


def _compared(
    scans: Sequence[ScanFile],
    comparisons: tuple[ScanComparison, ScanComparison],
    options: RunOptions,
) -> tuple[list[ScanPair], tuple[Failure, ...]]:
    """Compare the labels of scans by two runs, and log reasons to doubt the scores."""
    pairs: list[ScanPair] = []
    totals = [ScanCounts.none(c.space, by_distance=False) for c in comparisons]

    def add(result: tuple[ScanPair, list[ScanCounts]]) -> None:
        pair, counts = result
        pairs.append(pair)
        if counts and not pair.trained_on:
            for total, of_run in zip(totals, counts, strict=True):
                total.add(of_run)

    task = partial(_compare_scan, comparisons=comparisons)
    outcome = run_over_scans(task, scans, options, on_result=add)
    if not pairs:
        problem = f"no scan could be compared: {outcome.failures[0].reason}"
        raise NoInputError(comparisons[1].out, problem)
    for total, comparison in zip(totals, comparisons, strict=True):
        for text in total.label_warnings(comparison.space):
            log.warning("%s: %s", comparison.out, text)
    return pairs, outcome.failures


def _compare_scan(
    file: ScanFile, comparisons: tuple[ScanComparison, ScanComparison]
) -> tuple[ScanPair, list[ScanCounts]]:
    """Compare the labels of a scan by two runs, and with the truth if there is any."""
    space = comparisons[0].space
    paths = [output_path(c.out, file.sequence, "predictions", file.stem) for c in comparisons]
    before, after = (space.to_train(read_labels(path), strict=False, source=path) for path in paths)
    if len(before) != len(after):
        expected, hint = f"{len(before):,}, as {paths[0]}", "compare runs on the same scans"
        raise LabelError(paths[1], f"has {counted(len(after), 'label')}", expected, hint)
    pair = ScanPair(file, confusion_matrix(before, after, space.class_count))
    if not present(file.label_path):
        return pair, []
    counts = [comparison.count(file) for comparison in comparisons]
    for of_run in counts:
        of_run.histograms.clear()
    sums = np.array([class_sums(scored_rows(of_run.confusion, space)) for of_run in counts])
    return pair._replace(sums=sums, trained_on=bool(counts[0].trained_on)), counts
