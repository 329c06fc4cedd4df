# SPDX-License-Identifier: MIT
"""Stages `report` and `view`: the page of a run, as an HTML file or on a local server."""

from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from salsanext_cli.core.errors import NoInputError
from salsanext_cli.core.measures.counts import ScanCounts, SeparateCounts
from salsanext_cli.core.measures.decision import Verdict, verdict
from salsanext_cli.core.plain_data import plain
from salsanext_cli.io.files.atomic import require_target, write_target
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.page.clouds import scales_of
from salsanext_cli.report.page.html import html_of
from salsanext_cli.report.page.run_results import Comparison, RunResults
from salsanext_cli.report.page.scan_row import ScanRow
from salsanext_cli.report.page.thumbnails import scans_for_thumbnails, thumbnail
from salsanext_cli.report.readable_scans import readable_scans
from salsanext_cli.report.run_server import RunServer, ServedRun
from salsanext_cli.runs.annotation.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.annotation.label_records import pre_labelled_scans
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.summary.comparison import ScanComparison

PAGE = "report.html"


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """Page that was written."""

    page: Path
    run: RunResults  # Numbers of all scans on the page
    compared: Comparison | None  # Scores of the scans with labels, if any
    shown: dict[str, str]  # Scans that the page shows point by point, and why
    failures: tuple[Failure, ...]  # Scans that could not be read

    @property
    def verdict(self) -> Verdict | None:
        """What to do with the labels, None if it is unknown."""
        return verdict(self.run.evidence())

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON, null for NaN."""
        counts = self.run.counts
        trained_on = None
        on_training_scans = None
        if self.run.reader.trained_on.missing is None:
            trained_on = counts.skipped_training_scans if counts else 0
            on_training_scans = bool(counts and counts.training_scans)
        decision = self.verdict
        return {
            "stage": "report",
            "page": str(self.page),
            "bytes": self.page.stat().st_size,
            "scans": len(self.run.rows),
            "trained_on": trained_on,
            "on_training_scans": on_training_scans,
            "shown": self.shown,
            **_scores_as_data(self.compared),
            "decision": asdict(decision) if decision else None,
            **self.run.missing.to_dict(),
            "failures": [failure.to_dict() for failure in self.failures],
        }


def _scores_as_data(compared: Comparison | None) -> dict[str, object]:
    """Return the scores as plain data: those of all labels, or coverage and risk of accepted ones.

    Null stands for what the run does not have.
    """
    data: dict[str, object] = dict.fromkeys(
        ("accuracy", "iou_mean_present", "coverage", "risk", "sentence")
    )
    if compared is None:
        return data
    if compared.accepted is None:
        data["accuracy"] = plain(compared.scores.accuracy)
        data["iou_mean_present"] = plain(compared.scores.iou_mean_present)
    else:
        data["coverage"] = compared.accepted.coverage
        data["risk"] = compared.accepted.risk
    if compared.uncertainty.accepted:
        data["sentence"] = compared.uncertainty.accepted.sentence
    return data


def report(
    out: Path,
    target: Path | None = None,
    *,
    scans: Sequence[str] = (),
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> Report:
    """Write a page with settings and scores of a run, and the points of some scans.

    Parameters
    ----------
    out : Path
        Folder with results.
    target : Path, optional
        File of the page (.html), replaced only with ``options.overwrite``; by default
        `OUT/report.html`, which is replaced if it is unchanged since it was written.
    scans : sequence of str
        Scans to show point by point, such as ``08/000000``; by default up to four of interest.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers and progress.

    Returns
    -------
    Report
    """
    page = target or out / PAGE
    if target:
        require_target(target, options.overwrite, ".html")
    else:
        OwnedFolder(out).refuse_foreign([page])
    run, unread = read_run(out, query=query, options=options)
    reasons = run.scans_by_name(scans) if scans else run.notable_scans()
    readable = readable_scans(run, reasons)
    failures = (*unread, *readable.failures)
    compared = run.compared()
    html = html_of(
        run,
        compared,
        readable.scans,
        scales_of(readable.scans),
        [failure.reason for failure in failures],
        _thumbnails(run, reasons, options),
    )
    if target:
        write_target(target, html.encode(), overwrite=options.overwrite)
    else:
        OwnedFolder(out).replace({page: html.encode()})
    return Report(
        page=page,
        run=run,
        compared=compared,
        shown={scan.name: scan.reason for scan in readable.scans},
        failures=failures,
    )


def view(
    out: Path,
    *,
    port: int = 0,
    query: ResultQuery = ResultQuery(),
    options: RunOptions = RunOptions(),
) -> RunServer:
    """Read the results of a run and listen on a loopback port for a browser.

    Parameters
    ----------
    out : Path
        Folder with results.
    port : int
        Port of the server; 0 for any free port.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers and progress.

    Returns
    -------
    RunServer
        Server that answers after `serve_forever` is called.
    """
    server = RunServer(port)
    try:
        run, failures = read_run(out, query=query, options=options)
        served = ServedRun.from_results(run, failures)
        server.show(served, _thumbnails(run, run.notable_scans(), options))
    except BaseException:
        server.server_close()
        raise
    return server


def read_run(
    out: Path, *, query: ResultQuery = ResultQuery(), options: RunOptions = RunOptions()
) -> tuple[RunResults, tuple[Failure, ...]]:
    """Read the results of all scans of a run.

    Parameters
    ----------
    out : Path
        Folder with results.
    query : ResultQuery, optional
        Choice of the scans, their data set and classes.
    options : RunOptions, optional
        Workers and progress.

    Returns
    -------
    RunResults
        Numbers of the scans.
    tuple of Failure
        Scans that cannot be read.
    """
    results = ResultFolder(out, query.dataset)
    chosen = results.chosen(query)
    without_truth = pre_labelled_scans(chosen.scans)
    if warn_of_foreign_labels(chosen.scans, chosen.labels, results.provenance.recorded_sensor()):
        without_truth = chosen.scans
    reader = replace(
        ScanComparison.from_results(results.provenance, chosen.space, chosen.labels),
        unreviewed=frozenset(scan.name for scan in without_truth),
    )
    rows: list[ScanRow] = []
    counts = SeparateCounts(reader.space)
    training_rows: set[ScanRow] = set()

    def add(result: tuple[ScanRow, ScanCounts | None]) -> None:
        row, scan_counts = result
        rows.append(row)
        if scan_counts is None:
            return
        counts.add(scan_counts)
        if scan_counts.training_scans:
            training_rows.add(row)

    task = partial(ScanRow.read, reader=reader)
    outcome = run_over_scans(task, chosen.scans, options, on_result=add, reads=[out])
    if not rows:
        raise NoInputError(out, f"no results can be read: {outcome.failures[0].reason}")
    scored = counts.scored()
    if scored.skipped_training_scans:
        uncounted = np.zeros_like(rows[0].confusion)
        rows = [replace(row, confusion=uncounted) if row in training_rows else row for row in rows]
    rows.sort(key=lambda row: row.file)  # Workers finish in any order.
    counts_of_run = scored if scored.scans else None
    return RunResults(reader, rows, counts_of_run, chosen.missing), outcome.failures


def _thumbnails(run: RunResults, names: Collection[str], options: RunOptions) -> dict[str, str]:
    """Draw small pictures of some scans, by name; unreadable scans have none."""
    pictures: dict[str, str] = {}
    files = scans_for_thumbnails(run, names)
    task = partial(thumbnail, reader=run.reader, colours=screen_colours(run.reader.space))
    silent = RunOptions(jobs=options.jobs)
    run_over_scans(task, files, silent, on_result=lambda named: pictures.update([named]))
    return pictures
