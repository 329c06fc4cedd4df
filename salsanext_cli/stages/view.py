# SPDX-License-Identifier: MIT
"""Stage `view`: the page of a run with all its scans, served to a browser."""

from __future__ import annotations

from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NoInputError, OutputError, SalsanextError, escaped
from salsanext_cli.options import ScanSelection
from salsanext_cli.parallel.run import Failure, RunOptions
from salsanext_cli.report.page.clouds import encode_cloud, plain_scales, scales_of
from salsanext_cli.report.page.html import html_of
from salsanext_cli.report.page.run_results import RunResults, ShownScan, worth_looking_at
from salsanext_cli.report.page.server import PageServer
from salsanext_cli.results.layout import LABELLING_STAGES
from salsanext_cli.results.selection import MissingResults
from salsanext_cli.stages.report import read_run

SAMPLED = 5
"""Evenly spaced scans that the scales are taken from, besides those worth looking at."""


class View(PageServer):
    """Server of a run's page; `serve_forever` answers, and leaving the context closes the port.

    `scans`: number of scans that can be looked at; `missing`: scans without results, left out;
    `failures`: scans that could not be read.
    """

    def __init__(self, port: int) -> None:
        super().__init__(port)
        self.scans, self.missing = 0, MissingResults()
        self.failures: tuple[Failure, ...] = ()
        self._lock = Lock()

    def take(self, run: RunResults, failures: tuple[Failure, ...]) -> None:
        """Take the results that are served; raises `NoInputError` if no scan can be shown."""
        self._run, self._state = run, _state_of(run.reader.out)
        reasons = worth_looking_at(run.rows, run.reader.space)
        sample, unreadable = _sample(run, set(reasons))
        self.scans, self.missing = len(run.rows), run.missing
        self.failures = (*failures, *unreadable)
        self._scales = scales_of(sample)
        self._page = html_of(
            run,
            run.compared(),
            (),
            self._scales,
            [failure.reason for failure in self.failures],
            served={row.name: reasons.get(row.name, "") for row in run.rows},
            token=self.token,
        ).encode()

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "stage": "view",
            "url": self.url,
            "scans": self.scans,
            "missing": [str(scan.path) for scan in self.missing.scans],
            "not_asked_for": self.missing.not_asked_for,
            "failures": [failure.to_dict() for failure in self.failures],
        }

    def page(self) -> bytes:
        """Return the page as HTML."""
        return self._page

    def cloud(self, place: int) -> dict[str, Any] | None:
        """Read a scan; a kind of values keeps the scale that it first got."""
        if place >= self.scans:
            return None
        run = self._run
        if _state_of(run.reader.out) != self._state:
            raise OutputError(
                run.reader.out, "results were made anew since", remedy="start view again"
            )
        shown = run.read(run.rows[place])
        with self._lock:
            if new := shown.values().keys() - self._scales:
                self._scales |= {name: scales_of([shown])[name] for name in new}
        cloud = encode_cloud(shown, run.reader.space, run.reader.sensor, self._scales)
        cloud["scales"] = plain_scales(self._scales)
        found: dict[str, Any] = escaped(cloud)
        return found


def view(
    out: Path,
    *,
    port: int = 0,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    by_distance: bool = False,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> View:
    """Read the results of a run, and open a port on which a browser can look at them.

    `out`, `dataset`, `space`, `classes`, `by_distance`, `selection`, `options`: as for `report`;
    `port`: port on the loopback interface; 0 for any free one.
    """
    server = View(port)
    try:
        run, failures = read_run(
            out,
            dataset=dataset,
            space=space,
            classes=classes,
            by_distance=by_distance,
            selection=selection,
            options=options,
        )
        server.take(run, failures)
    except BaseException:
        server.server_close()
        raise
    return server


def _state_of(out: Path) -> list[tuple[int, int] | None]:
    """Return size and time of the records of the stages whose results are shown."""
    paths = [out / f"{stage}.json" for stage in LABELLING_STAGES]
    states = [path.stat() if path.exists() else None for path in paths]
    return [state and (state.st_size, state.st_mtime_ns) for state in states]


def _sample(run: RunResults, chosen: set[str]) -> tuple[list[ShownScan], list[Failure]]:
    """Read chosen scans and evenly spaced ones; raise `NoInputError` if none can be read."""
    sample: list[ShownScan] = []
    failures: list[Failure] = []
    spaced = set(np.linspace(0, len(run.rows) - 1, SAMPLED).astype(int).tolist())
    for place, row in enumerate(run.rows):
        if place in spaced or row.name in chosen:
            try:
                sample.append(run.read(row))
            except SalsanextError as error:
                failures.append(Failure(row.file, str(error), error.code))
    if not sample:
        raise NoInputError(run.reader.out, f"no scan can be shown, as {failures[0].reason}")
    return sample, failures
