# SPDX-License-Identifier: MIT
"""Stage `view`: the page of a run with all its scans, while it runs."""

from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import NoInputError, SalsanextError, as_text
from salsanext_cli.parallel.run import Failure, RunOptions
from salsanext_cli.report.page.clouds import encode_cloud, plain_scales, scales_of
from salsanext_cli.report.page.html import html_of
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.report.page.server import PageServer
from salsanext_cli.report.page.shown_scans import ShownScan
from salsanext_cli.stages.report import read_run
from salsanext_cli.storage.selection import ScanSelection

SAMPLED = 5
"""Scans that the scales of all are taken from."""


class View(PageServer):
    """Server of a run's page; a context that `serve_forever` runs in.

    Attributes
    ----------
    scans : int
        Number of scans that can be looked at.
    missing : MissingResults
        Scans without results, left out.
    failures : tuple of Failure
        Scans that could not be read, left out.
    """

    def __init__(self, port: int, run: RunResults, failures: tuple[Failure, ...]) -> None:
        self.scans, self.missing, self.failures = len(run.rows), run.missing, failures
        self._run = run
        sample = _sample(run)
        self._scales = scales_of(sample)
        reasons = [failure.reason for failure in failures]
        content = run.content(sample, run.compared(), reasons, live=True)
        super().__init__(port, html_of(content), self._cloud)

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

    def _cloud(self, place: int) -> dict[str, Any] | None:
        """Read a scan; values that the sample does not have get a scale of their own."""
        if place >= self.scans:
            return None
        shown = self._run.read(self._run.rows[place])
        scales = scales_of([shown]) | self._scales
        cloud = encode_cloud(shown, self._run.how["space"], self._run.how["sensor"], scales)
        cloud["scales"] = plain_scales(scales)
        return {**as_text(cloud)}


def view(
    out: Path,
    *,
    port: int = 0,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
    selection: ScanSelection = ScanSelection(),
    options: RunOptions = RunOptions(),
) -> View:
    """Read the results of a run, and open a port on which a browser can look at them.

    Parameters
    ----------
    out, dataset, space, classes, selection, options
        As for `report`.
    port : int
        Port on the loopback interface; 0 for any free one.

    Raises
    ------
    SalsanextError
        If there is nothing to look at, or the port cannot be used.
    """
    run, failures = read_run(
        out, dataset=dataset, space=space, classes=classes, selection=selection, options=options
    )
    return View(port, run, failures)


def _sample(run: RunResults) -> list[ShownScan]:
    """Read evenly spaced scans; those that cannot be read are told when they are asked for."""
    sample: list[ShownScan] = []
    reason = ""
    for place in np.unique(np.linspace(0, len(run.rows) - 1, SAMPLED).astype(int)):
        try:
            sample.append(run.read(run.rows[place]))
        except SalsanextError as error:
            reason = str(error)
    if not sample:
        raise NoInputError(run.out, f"no scan can be shown, as {reason}")
    return sample
