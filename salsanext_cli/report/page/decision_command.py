# SPDX-License-Identifier: MIT
"""Command that follows from the decision about a run, with the scans and weights of the run."""

from __future__ import annotations

from pathlib import Path

from salsanext_cli.core.measures.decision import Decision, Verdict
from salsanext_cli.core.wording import setting
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.repeated_settings import (
    SETTINGS_OF_LABELS,
    path_as_typed,
    settings_of_network,
)
from salsanext_cli.runs.results.scan_arguments import UNKNOWN_SCANS
from salsanext_cli.runs.scans.selection import data_set_of


def decision_command(run: RunResults, decided: Verdict) -> str:
    """Return the command that follows from a decision; empty if there is none."""
    scans, settings = _scans(run)
    # `pick` takes no origin; the other command labels the same scans again, in coarse classes.
    is_prediction = decided.decision is Decision.COARSE
    omitted = ("classes",) if is_prediction else SETTINGS_OF_LABELS
    settings += settings_of_network(Manifest(run.reader.out), omitted)
    return decided.command(str(scans), settings)


def _scans(run: RunResults) -> tuple[Path, list[str]]:
    """Return the folder of the scans, and the settings that choose their sequences in it."""
    files = [row.file for row in run.rows]
    folders = {file.path.parent for file in files}
    if len(folders) == 1:
        return path_as_typed(folders.pop()), []
    data_sets = {data_set_of(file) for file in files}
    data_set = data_sets.pop()
    if data_sets or data_set is None:
        return Path(UNKNOWN_SCANS), []
    sequences = sorted({file.sequence for file in files})
    return path_as_typed(data_set), [setting("sequences", ",".join(sequences))]
