# SPDX-License-Identifier: MIT
"""Stage `report`: one page of a run, a single HTML file that needs nothing else."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import (
    NoInputError,
    SalsanextError,
)
from salsanext_cli.measures.scan_counts import CountsApart, ScanCounts
from salsanext_cli.measures.scores import plain
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Failure, RunOptions, run_over_scans
from salsanext_cli.report.page.clouds import scales_of
from salsanext_cli.report.page.html import html_of
from salsanext_cli.report.page.run_results import (
    RunReader,
    RunResults,
    ScanRow,
    ShownScan,
    named,
    read_row,
    worth_looking_at,
)
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.selection import MissingResults, space_of_labels
from salsanext_cli.results.stage_records import StageRecords

PAGE = "report.html"
"""Name of the page in the output folder."""


@dataclass(frozen=True, slots=True)
class Report:
    """Page that was written."""

    page: Path
    bytes: int  # Its size
    scans: int  # Number of scans of which it gives the numbers
    # Number of labelled scans left out of the scores since the weights were trained on them
    trained_on: int
    # Whether the weights were trained on every labelled scan, so that all are scored
    on_training_scans: bool
    shown: dict[str, str]  # Scans that it shows point by point, and why
    accuracy: float | None  # Scores of the labelled scans, 0…1; None without labels
    iou_mean_present: float | None
    sentence: str | None  # Sentence on risk; None without labels or uncertainty
    missing: MissingResults  # Scans without results, left out
    failures: tuple[Failure, ...]  # Scans that could not be read, left out

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        return {
            "stage": "report",
            "page": str(self.page),
            "bytes": self.bytes,
            "scans": self.scans,
            "trained_on": self.trained_on,
            "on_training_scans": self.on_training_scans,
            "shown": self.shown,
            "accuracy": plain(self.accuracy),
            "iou_mean_present": plain(self.iou_mean_present),
            "sentence": self.sentence,
            "missing": [str(scan.path) for scan in self.missing.scans],
            "not_asked_for": self.missing.not_asked_for,
            "failures": [failure.to_dict() for failure in self.failures],
        }


def report(
    out: Path,
    *,
    scans: Sequence[str] = (),
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    by_distance: bool = False,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> Report:
    """Write `OUT/report.html`: what was run, the numbers of all scans, and some scans to look at.

    `out`: the output folder, with what earlier stages left there; `scans`: names of the scans to
    show point by point, ``08/000000``; without any, up to four that are worth looking at;
    `dataset`: where the scans and labels are, if not where the scans came from; `space`, `classes`:
    of the labels, and into whose classes others are merged; as for `ResultFolder.predicted`;
    `by_distance`: score rings of distance too, for which all labelled scans are read; `selection`,
    `options`: which scans, and how to go through them.
    """
    page = out / PAGE
    OwnedFolder(out).require_own([page])
    run, failures = read_run(
        out,
        dataset=dataset,
        space=space,
        classes=classes,
        by_distance=by_distance,
        selection=selection,
        options=options,
    )
    chosen = named(run.rows, scans) if scans else worth_looking_at(run.rows, run.reader.space)
    shown, unreadable = _shown(run, chosen)
    failures += unreadable
    compared = run.compared()
    reasons = [failure.reason for failure in failures]
    written = html_of(run, compared, shown, scales_of(shown), reasons).encode()
    OwnedFolder(out).replace({page: written})
    kept = compared.uncertainty.kept if compared else None
    return Report(
        page=page,
        bytes=len(written),
        scans=len(run.rows),
        trained_on=run.counts.left_out if run.counts else 0,
        on_training_scans=bool(run.counts and run.counts.trained_on),
        shown={each.name: each.reason for each in shown},
        accuracy=compared.scores.accuracy if compared else None,
        iou_mean_present=compared.scores.iou_mean_present if compared else None,
        sentence=kept.sentence if kept else None,
        missing=run.missing,
        failures=failures,
    )


def read_run(
    out: Path,
    *,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    by_distance: bool = False,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> tuple[RunResults, tuple[Failure, ...]]:
    """Read the results of all scans of a run; arguments and errors are as for `report`."""
    results = ResultFolder(out, dataset)
    asked, results_space = results.predicted(selection, space, classes)
    results.require_same_weights()
    files = results.with_results(asked)
    missing = results.missing_results(set(asked) - set(files))
    missing.log_error(len(asked), "results")
    labels = space_of_labels(files, results_space, space)
    merging = results.merging_into(results_space)
    sensor = results.sensor()
    reader = RunReader(out, results_space, labels, merging, sensor)
    rows, counts, failures = _rows(files, reader, by_distance, options)
    return RunResults(reader, rows, counts, missing), failures


def _rows(
    files: Sequence[ScanFile],
    reader: RunReader,
    by_distance: bool,
    options: RunOptions,
) -> tuple[list[ScanRow], ScanCounts | None, tuple[Failure, ...]]:
    """Read the results of all scans; count those with labels."""
    rows: list[ScanRow] = []
    counts = CountsApart.none(reader.space, by_distance)
    trained_on: set[ScanRow] = set()

    def keep(found: tuple[ScanRow, ScanCounts | None]) -> None:
        row, of_scan = found
        rows.append(row)
        if of_scan and of_scan.trained_on:
            trained_on.add(row)
        if of_scan:
            counts.add(of_scan)

    known = StageRecords(reader.out).trained_on()
    task = partial(read_row, reader=reader, by_distance=by_distance, trained_on=known)
    outcome = run_over_scans(task, files, options, on_result=keep)
    if not rows:
        raise NoInputError(reader.out, f"no results can be read, as {outcome.failures[0].reason}")
    if (scored := counts.scored()).left_out:
        rows = [replace(row, confusion=None) if row in trained_on else row for row in rows]
    # Workers are done in any order.
    rows.sort(key=lambda row: (row.file.sequence, row.file.stem))
    return rows, scored if scored.scans else None, outcome.failures


def _shown(
    run: RunResults, chosen: Mapping[str, str]
) -> tuple[list[ShownScan], tuple[Failure, ...]]:
    """Read the chosen scans; if none can be read, there is nothing to show."""
    rows = {row.name: row for row in run.rows}
    shown: list[ShownScan] = []
    failures: list[Failure] = []
    for name, reason in chosen.items():
        try:
            shown.append(run.read(rows[name], reason))
        except SalsanextError as error:
            failures.append(Failure(rows[name].file, str(error), error.code))
    if not shown:
        raise NoInputError(run.reader.out, f"no scan can be shown, as {failures[0].reason}")
    return shown, tuple(failures)
