# SPDX-License-Identifier: MIT
"""Live page of a run, which asks the server for the points of each scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import escaped
from salsanext_cli.report.page.clouds import Scale, encode_cloud, scales_of
from salsanext_cli.report.page.html import Served, html_of
from salsanext_cli.report.page.run_results import RunResults, ShownScan
from salsanext_cli.report.page.server import PageServer
from salsanext_cli.report.readable_scans import readable_scans
from salsanext_cli.runs.loop.run import Failure
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.scans.selection import MissingResults

SAMPLED = 5  # Evenly spaced scans among those from which the scales are taken


@dataclass(slots=True, kw_only=True)
class ServedRun:
    """Results of a run that are served, and the scales of their values."""

    results: RunResults
    failures: tuple[Failure, ...]  # Scans that could not be read
    scales: dict[str, Scale]
    recorded: RecordState  # State of the records when the results were read
    lock: Lock = field(default_factory=Lock)  # Of the scales

    @classmethod
    def from_results(cls, results: RunResults, failures: tuple[Failure, ...]) -> ServedRun:
        """Take the scales from notable and evenly spaced scans.

        Parameters
        ----------
        results : RunResults
            Numbers of all scans.
        failures : tuple of Failure
            Scans without numbers.

        Returns
        -------
        ServedRun

        Raises
        ------
        NoInputError
            If no scan can be shown.
        """
        recorded = record_state(results.reader.out)
        notable = results.notable_scans()
        last = len(results.rows) - 1
        spaced = {*np.linspace(0, last, SAMPLED).astype(int).tolist()}
        sample = {
            row.file.name: ""
            for index, row in enumerate(results.rows)
            if index in spaced or row.file.name in notable
        }
        readable = readable_scans(results, sample)
        return cls(
            results=results,
            failures=(*failures, *readable.failures),
            scales=dict(scales_of(readable.scans)),
            recorded=recorded,
        )

    def page(self, thumbnails: Mapping[str, str], token: str) -> bytes:
        """Return the page, which offers every scan; `token` is part of the address of a cloud."""
        notable = self.results.notable_scans()
        reasons = {row.file.name: notable.get(row.file.name, "") for row in self.results.rows}
        problems = [failure.reason for failure in self.failures]
        served = Served(reasons=reasons, token=token)
        compared = self.results.compared()
        page = html_of(self.results, compared, (), self.scales, problems, thumbnails, served)
        return page.encode()

    def cloud(self, index: int) -> dict[str, object] | None:
        """Read a scan by its index; a kind of value keeps its first scale."""
        rows = self.results.rows
        if index >= len(rows):
            return None
        reader = self.results.reader
        if record_state(reader.out) != self.recorded:
            problem = "has new results since view started"
            raise OutputError(reader.out, problem, hint="start view again")
        scan = self.results.read(rows[index])
        self._add_scales(scan)
        cloud = encode_cloud(scan, reader.space, reader.sensor, self.scales)
        cloud["scales"] = self.scales
        return dict(escaped(cloud))

    def _add_scales(self, scan: ShownScan) -> None:
        """Add the scales of values that no scan had before."""
        with self.lock:
            unscaled = scan.values().keys() - self.scales
            if unscaled:
                scales = scales_of([scan])
                self.scales = self.scales | {name: scales[name] for name in unscaled}


class RunServer(PageServer):
    """Server of the page of a run and of the points of its scans."""

    served: ServedRun

    def show(self, served: ServedRun, thumbnails: Mapping[str, str]) -> None:
        """Serve a run from now on, with small pictures of some scans by name."""
        self.served = served
        self.page = served.page(thumbnails, self.token)

    @property
    def scans(self) -> int:
        """Number of scans on the page."""
        return len(self.served.results.rows)

    @property
    def missing(self) -> MissingResults:
        """Scans without results."""
        return self.served.results.missing

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Scans that could not be read."""
        return self.served.failures

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        data: dict[str, Any] = {"stage": "view", "url": self.url, "scans": self.scans}
        data |= self.missing.to_dict()
        data["failures"] = plain(self.failures)
        return data

    def cloud(self, index: int) -> dict[str, object] | None:
        """Read a scan by its index; None if there is no such scan."""
        return self.served.cloud(index)


RecordState = list[tuple[int, int] | None]
"""Size in bytes and time in nanoseconds of each record; None for a record that is absent."""


def record_state(out: Path) -> RecordState:
    """Return the state of the records of the stages that wrote the results in a folder."""
    state: RecordState = []
    for stage in PREDICTION_STAGES:
        record = out / f"{stage}.json"
        if record.exists():
            properties = record.stat()
            state.append((properties.st_size, properties.st_mtime_ns))
        else:
            state.append(None)
    return state
