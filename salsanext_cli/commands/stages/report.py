# SPDX-License-Identifier: MIT
"""Stages `report` and `view`: the page of a run, as an HTML file or on a local server."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from threading import Lock

import numpy as np

from salsanext_cli.core.errors import NoInputError, OutputError, SalsanextError
from salsanext_cli.core.measures.counts import ScanCounts, SeparateCounts
from salsanext_cli.core.measures.decision import Verdict, verdict
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import escaped
from salsanext_cli.io.files.atomic import require_target, write_bytes
from salsanext_cli.report.colours import screen_colours
from salsanext_cli.report.page.clouds import encode_cloud, scales_of
from salsanext_cli.report.page.html import Served, html_of
from salsanext_cli.report.page.run_results import Comparison, RunResults, ShownScan
from salsanext_cli.report.page.scan_row import ScanRow
from salsanext_cli.report.page.server import PageServer
from salsanext_cli.report.page.thumbnails import scans_for_thumbnails, thumbnail
from salsanext_cli.runs.labelling.label_records import pre_labelled_scans
from salsanext_cli.runs.loop.run import Failure, RunOptions, run_over_scans
from salsanext_cli.runs.results.foreign_labels import warn_of_foreign_labels
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.paths import PREDICTION_STAGES
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.summary.comparison import ScanComparison

PAGE = "report.html"
SAMPLED = 5  # Evenly spaced scans among those from which `view` takes the scales


@dataclass(frozen=True, slots=True)
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
        counts, compared = self.run.counts, self.compared
        scores, labels = compared and compared.scores, compared and compared.accepted
        best = compared and compared.uncertainty.accepted
        decided = self.verdict
        is_known = self.run.reader.trained_on.missing is None
        return {
            "stage": "report",
            "page": str(self.page),
            "bytes": self.page.stat().st_size,
            "scans": len(self.run.rows),
            "trained_on": (counts.skipped if counts else 0) if is_known else None,
            "on_training_scans": bool(counts and counts.trained_on) if is_known else None,
            "shown": self.shown,
            "accuracy": plain(scores.accuracy) if scores and not labels else None,
            "iou_mean_present": plain(scores.iou_mean_present) if scores and not labels else None,
            "coverage": labels and labels.coverage,
            "risk": labels and labels.risk,
            "sentence": best and best.sentence,
            "decision": decided and asdict(decided),
            **self.run.missing.to_dict(),
            "failures": [failure.to_dict() for failure in self.failures],
        }


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
    query, options
        See `read_run`.

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
    chosen = run.scans_by_name(scans) if scans else run.notable_scans()
    rows = {row.file.name: row for row in run.rows}
    shown, unshown = _readable(run, ((rows[name], reason) for name, reason in chosen.items()))
    failures, compared = (*unread, *unshown), run.compared()
    reasons = [failure.reason for failure in failures]
    pictures = _thumbnails(run, chosen, options)
    html = html_of(run, compared, shown, scales_of(shown), reasons, pictures)
    if target:
        write_bytes(target, html.encode())
    else:
        OwnedFolder(out).replace({page: html.encode()})
    return Report(page, run, compared, {s.name: s.reason for s in shown}, failures)


class RunServer(PageServer):
    """Server of the page of a run, with the number of `scans`, the `missing` and `failures`."""

    def take(
        self, run: RunResults, failures: tuple[Failure, ...], thumbnails: Mapping[str, str]
    ) -> None:
        """Take the results to serve; raise `NoInputError` if no scan can be shown."""
        self._run, self._state, self._lock = run, _state_of(run.reader.out), Lock()
        reasons = run.notable_scans()
        spaced = {*np.linspace(0, len(run.rows) - 1, SAMPLED).astype(int).tolist()}
        chosen = (r for i, r in enumerate(run.rows) if i in spaced or r.file.name in reasons)
        sample, unread = _readable(run, ((row, "") for row in chosen))
        self.scans, self.missing = len(run.rows), run.missing
        self.failures = (*failures, *unread)
        self._scales = scales_of(sample)
        problems = [failure.reason for failure in self.failures]
        served = {row.file.name: reasons.get(row.file.name, "") for row in run.rows}
        page = html_of(
            run, run.compared(), (), self._scales, problems, thumbnails, Served(served, self.token)
        )
        self.page = page.encode()

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        server = {"stage": "view", "url": self.url, "scans": self.scans}
        return server | self.missing.to_dict() | {"failures": plain(self.failures)}

    def cloud(self, index: int) -> dict[str, object] | None:
        """Read a scan; a kind of value keeps its first scale."""
        if index >= self.scans:
            return None
        run = self._run
        if _state_of(run.reader.out) != self._state:
            problem = "has new results since view started"
            raise OutputError(run.reader.out, problem, hint="start view again")
        shown = run.read(run.rows[index])
        with self._lock:
            if new := shown.values().keys() - self._scales:
                self._scales |= {name: scales_of([shown])[name] for name in new}
        cloud = encode_cloud(shown, run.reader.space, run.reader.sensor, self._scales)
        cloud["scales"] = self._scales
        return dict(escaped(cloud))


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
    query, options
        See `read_run`.

    Returns
    -------
    RunServer
        Server that answers after `serve_forever` is called.
    """
    server = RunServer(port)
    try:
        run, failures = read_run(out, query=query, options=options)
        server.take(run, failures, _thumbnails(run, run.notable_scans(), options))
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
    query, options
        Choice of scans, data set and classes; workers and progress.

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
    if warn_of_foreign_labels(chosen.scans, chosen.labels, results.known_sensor()):
        without_truth = chosen.scans
    reader = replace(
        ScanComparison.of_results(results, chosen.space, chosen.labels),
        unreviewed=frozenset(scan.name for scan in without_truth),
    )
    rows: list[ScanRow] = []
    counts = SeparateCounts(reader.space)
    trained_on: set[ScanRow] = set()

    def add(result: tuple[ScanRow, ScanCounts | None]) -> None:
        row, scan_counts = result
        rows.append(row)
        if scan_counts:
            counts.add(scan_counts)
            if scan_counts.trained_on:
                trained_on.add(row)

    task = partial(ScanRow.read, reader=reader)
    outcome = run_over_scans(task, chosen.scans, options, on_result=add)
    if not rows:
        raise NoInputError(out, f"no results can be read: {outcome.failures[0].reason}")
    if (scored := counts.scored()).skipped:
        none = np.zeros_like(rows[0].confusion)
        rows = [replace(row, confusion=none) if row in trained_on else row for row in rows]
    rows.sort(key=lambda row: row.file)  # Workers finish in any order.
    of_labelled = scored if scored.scans else None
    return RunResults(reader, rows, of_labelled, chosen.missing), outcome.failures


def _thumbnails(run: RunResults, names: Collection[str], options: RunOptions) -> dict[str, str]:
    """Draw small pictures of some scans, by name; unreadable scans have none."""
    pictures: dict[str, str] = {}
    files = scans_for_thumbnails(run, names)
    task = partial(thumbnail, reader=run.reader, colours=screen_colours(run.reader.space))
    silent = RunOptions(jobs=options.jobs)
    run_over_scans(task, files, silent, on_result=lambda named: pictures.update([named]))
    return pictures


def _readable(
    run: RunResults, chosen: Iterable[tuple[ScanRow, str]]
) -> tuple[list[ShownScan], tuple[Failure, ...]]:
    """Read scans to show, with a reason for each; raise `NoInputError` if none can be read."""
    shown: list[ShownScan] = []
    failures: list[Failure] = []
    for row, reason in chosen:
        try:
            shown.append(run.read(row, reason))
        except SalsanextError as error:
            failures.append(Failure.of(row.file, error))
    if not shown:
        raise NoInputError(run.reader.out, f"no scan can be shown: {failures[0].reason}")
    return shown, tuple(failures)


def _state_of(out: Path) -> list[tuple[int, int] | None]:
    """Return size and time of the records of the stages that wrote the results."""
    paths = [out / f"{stage}.json" for stage in PREDICTION_STAGES]
    states = [path.stat() if path.exists() else None for path in paths]
    return [state and (state.st_size, state.st_mtime_ns) for state in states]
