# SPDX-License-Identifier: MIT
"""Runs of stages that begin and end without working on a scan."""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.output_run import OutputRun, output_run


def begin_and_end(
    out: Path,
    stage: str,
    settings: Mapping[str, Any],
    folders: Iterable[str],
    scans: Sequence[ScanFile] = (),
    *,
    overwrite: bool = False,
) -> OutputRun:
    """Register a run in an output folder, as one does that finds nothing to do."""
    with output_run(out, stage, settings, folders, scans, overwrite=overwrite) as output:
        return output
