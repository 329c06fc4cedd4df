# SPDX-License-Identifier: MIT
"""Runs of the work of `worker_tasks.py`; no worker process imports this file."""

from collections.abc import Sequence

from worker_tasks import Write

from salsanext_cli.io.files.atomic import MARK, sweep
from salsanext_cli.runs.loop.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.runs.scans.scan_file import ScanFile


def run(work: Write, scans: Sequence[ScanFile], **options: object) -> Outcome:
    """Run such work on the scans that have no file yet, and sweep up after killed workers."""
    chosen = RunOptions(**options)  # type: ignore[arg-type]
    try:
        return run_over_scans(work, scans, chosen, is_done=lambda scan: work.path(scan).exists())
    finally:
        for folder in {work.path(scan).parent for scan in scans}:
            sweep(folder, MARK.get())
