# SPDX-License-Identifier: MIT
"""Record of the warnings of a run in its output folder."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.run_summary import RunSummary


@contextmanager
def recorded_summary(
    summary: RunSummary, run: OutputRun, scans: Sequence[ScanFile]
) -> Iterator[None]:
    """Finish a summary when the body ends; record its findings and add those of earlier runs.

    Parameters
    ----------
    summary : RunSummary
        Summary to which the body adds the scans.
    run : OutputRun
        Run that has the record.
    scans : sequence of ScanFile
        Scans of the run, whose earlier findings count.
    """
    summary.findings.out = run.root
    try:
        yield
    finally:
        summary.compare_scans()
        earlier = run.record_findings(_findings_by_name(summary), summary.names)
        _add_earlier(summary, earlier, run, scans)
        summary.finished()


def _findings_by_name(summary: RunSummary) -> dict[str, list[Finding]]:
    """Return the findings of a summary by name of scan or sequence."""
    by_name: dict[str, list[Finding]] = {}
    for findings in summary.findings.by_code.values():
        for name, finding in findings:
            by_name.setdefault(name, []).append(finding)
    return by_name


def _add_earlier(
    summary: RunSummary,
    earlier: dict[str, list[Finding]],
    run: OutputRun,
    scans: Sequence[ScanFile],
) -> None:
    """Add the findings of earlier runs about scans whose results are in the folder."""
    names_of_run = {file.name for file in scans}
    for name in sorted(earlier.keys() & run.names_of_results(earlier)):
        for finding in earlier[name]:
            summary.findings.earlier.setdefault(finding.code, []).append(name)
            if name in names_of_run:
                summary.findings.add(name, finding)
