# SPDX-License-Identifier: MIT
"""Scans of a run whose points can be read, to show them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from salsanext_cli.core.errors import NoInputError, SalsanextError
from salsanext_cli.report.page.run_results import RunResults, ShownScan
from salsanext_cli.runs.loop.run import Failure


@dataclass(frozen=True, slots=True, kw_only=True)
class ReadableScans:
    """Scans to show point by point, and those that could not be read."""

    scans: tuple[ShownScan, ...]  # At least one
    failures: tuple[Failure, ...]


def readable_scans(run: RunResults, reasons: Mapping[str, str]) -> ReadableScans:
    """Read the points of some scans of a run.

    Parameters
    ----------
    run : RunResults
        Numbers of all scans.
    reasons : mapping of str to str
        Why each scan is shown, by its name.

    Returns
    -------
    ReadableScans

    Raises
    ------
    NoInputError
        If none of them can be read.
    """
    rows = {row.file.name: row for row in run.rows}
    scans: list[ShownScan] = []
    failures: list[Failure] = []
    for name, reason in reasons.items():
        try:
            scans.append(run.read(rows[name], reason))
        except SalsanextError as error:
            failures.append(Failure.from_error(rows[name].file, error))
    if not scans:
        raise NoInputError(run.reader.out, f"no scan can be shown: {failures[0].reason}")
    return ReadableScans(scans=tuple(scans), failures=tuple(failures))
