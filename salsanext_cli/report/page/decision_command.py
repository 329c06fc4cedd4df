# SPDX-License-Identifier: MIT
"""Command that follows from the decision about a run, with the scans and weights of the run."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.measures.decision import Verdict
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.weights.card_file import default_weights
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.selection import data_set_of

UNKNOWN_SCANS = Path("SCANS")
UNKNOWN_WEIGHTS = "WEIGHTS"
"""Words for what a run does not record, and for what was moved since."""


def decision_command(run: RunResults, decided: Verdict) -> str:
    """Return the command that follows from a decision; empty if there is none."""
    scans, settings = _scans(run)
    return decided.command(str(scans), [*settings, *_weights(Manifest(run.reader.out))])


def _scans(run: RunResults) -> tuple[Path, list[str]]:
    """Return the folder of the scans, and the settings that choose their sequences in it."""
    files = [row.file for row in run.rows]
    folders = {file.path.parent for file in files}
    if len(folders) == 1:
        return _as_typed(folders.pop()), []
    data_sets = {data_set_of(file) for file in files}
    data_set = data_sets.pop()
    if data_sets or data_set is None:
        return UNKNOWN_SCANS, []
    sequences = sorted({file.sequence for file in files})
    return _as_typed(data_set), [setting("sequences", ",".join(sequences))]


def _weights(records: Manifest) -> list[str]:
    """Return the setting of the weights of `predict`; empty for the default weights."""
    record = records.record("predict")
    settings = records.settings("predict")
    if record is None or settings is None or settings.weights is None:
        return []
    # An installation without its weights still shows results.
    with suppress(SalsanextError):
        if fingerprint(default_weights()) == settings.weights:
            return []
    with suppress(SalsanextError):
        path = Path(record.weights_file)
        if record.weights_file and fingerprint(path) == settings.weights:
            return [setting("weights", _as_typed(path))]
    return [setting("weights", UNKNOWN_WEIGHTS)]


def _as_typed(path: Path) -> Path:
    """Return a path relative to the current folder if it is in it, else absolute."""
    absolute = path.absolute()
    here = Path.cwd()
    return absolute.relative_to(here) if absolute.is_relative_to(here) else absolute
