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
OLD_PAGE = "compare.html"  # Of older versions, about other results

log = logging.getLogger(__name__)


def compare_scan(
    file: ScanFile,
    comparisons: tuple[ScanComparison, ScanComparison],
) -> tuple[ScanPair, list[ScanCounts]]:
    """Compare the labels of a scan by two runs with each other, and with the truth if there is."""
    space = comparisons[0].space
    paths = [output_path(c.out, file.sequence, "predictions", file.stem) for c in comparisons]
    before, after = (space.to_train(read_labels(path), strict=False, source=path) for path in paths)
    if len(before) != len(after):
        found, hint = counted(len(after), "label"), "compare runs on the same scans"
        raise LabelError(paths[1], found, f"{len(before):,}, as {paths[0]}", hint)
    pair = ScanPair(file, confusion_matrix(before, after, space.class_count))
    if not present(file.label_path):
        return pair, []
    counts = [comparison.count(file) for comparison in comparisons]
    for each in counts:
        each.histograms.clear()
    parts = zip(*((each.confusion, *each.bands) for each in counts), strict=True)
    sums = [[class_sums(scored_rows(each, space)) for each in part] for part in parts]
    return pair._replace(sums=np.array(sums), trained_on=bool(counts[0].trained_on)), counts


def _require_same(one: ScanFile, other: ScanFile, sensor: Sensor) -> None:
    """Refuse two files of a scan that are not the same points."""
    if one.path == other.path:
        return
    points, others = (read_scan(file.path, sensor).points for file in (one, other))
    if not np.array_equal(points, others, equal_nan=True):
        raise UsageError(other.path, f"other points than {one.path}", "two runs on the same scans")


def compare(
    before: Path,
    after: Path,
    *,
    by_distance: bool = False,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> tuple[RunComparison, tuple[Failure, ...]]:
    """Compare two output folders; write `compare.json` into the second one."""
    if before.resolve() == after.resolve():
        raise UsageError("OUT_B", f"{after}, as OUT_A", "the folder of another run")
    runs = ResultFolder(before, query.dataset), ResultFolder(after, query.dataset)
    OwnedFolder(after).require_own([after / RECORD])
    both, alone, space = _common_scans(runs, query)
    sensor, labels = runs[0].sensor(), space_of_labels(both, space, query.label_space)
    trained_on = runs[0].trained_on() | runs[1].trained_on()
    one, other = (
        replace(
            ScanComparison.of_results(run, space, labels, by_distance=by_distance),
            sensor=sensor,
            rejection=None,
            trained_on=trained_on,
        )
        for run in runs
    )
    pairs, failures = _compared(both, (one, other), options)
    rejecting = any(run.rejection() for run in runs)
    result = RunComparison(space, sorted(pairs, key=lambda pair: pair.file), rejecting)
    content = {"stage": "compare", "before": str(before), "after": str(after), "alone": alone}
    content |= {"weights": [run.weights("predictions") for run in runs], **result.to_dict()}
    OwnedFolder(after).replace({after / RECORD: encode_json(escaped(content))})
    OwnedFolder(after).remove_own([after / OLD_PAGE])
    return result, failures


def _common_scans(
    runs: tuple[ResultFolder, ResultFolder], query: ResultQuery
) -> tuple[list[ScanFile], int, LabelSpace]:
    """Return the scans with labels of both runs, the number of the others, and the classes."""
    before, after = (run.root for run in runs)
    (chosen, space), (others, own) = (
        run.predicted(query.selection, query.label_space, query.classes) for run in runs
    )
    if not space.fits(own):
        found = f"{first_few(space.differences(own))}"
        raise UsageError(after, found, f"the classes of {before}", "merge both, --classes coarse")
    of_before, of_after = (
        {scan.name: scan for scan in with_outputs(each, run.root, "predictions")}
        for each, run in zip((chosen, others), runs, strict=True)
    )
    both = [scan for name, scan in of_before.items() if name in of_after]
    if not both:
        raise NoInputError(after, f"no scan that {before} has labels of", "the same scans")
    for _, members in groupby(both, lambda scan: scan.sequence):
        _require_same(first := next(members), of_after[first.name], runs[0].sensor())
    if alone := len(of_before.keys() ^ of_after):
        log.warning("%s left out, with labels of one run only", counted(alone, "scan"))
    return both, alone, space


def _compared(
    scans: Sequence[ScanFile],
    comparisons: tuple[ScanComparison, ScanComparison],
    options: RunOptions,
) -> tuple[list[ScanPair], tuple[Failure, ...]]:
    """Compare the labels of scans by two runs, and log what the scores do not tell."""
    pairs: list[ScanPair] = []
    totals = [ScanCounts.none(each.space, each.by_distance) for each in comparisons]

    def keep(found: tuple[ScanPair, list[ScanCounts]]) -> None:
        pairs.append(found[0])
        if not found[0].trained_on:
            for total, counts in zip(totals, found[1], strict=bool(found[1])):
                total.add(counts)

    task = partial(compare_scan, comparisons=comparisons)
    outcome = run_over_scans(task, scans, options, on_result=keep)
    if not pairs:
        reason = outcome.failures[0].reason
        raise NoInputError(comparisons[1].out, f"no scan could be compared, as {reason}")
    for total, comparison in zip(totals, comparisons, strict=True):
        for text in total.label_warnings(comparison.space):
            log.warning("%s: %s", comparison.out, text)
    return pairs, outcome.failures
