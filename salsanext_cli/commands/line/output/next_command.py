# SPDX-License-Identifier: MIT
"""Command line that usually follows a run."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from salsanext_cli.core.wording import command

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from salsanext_cli.runs.loop.run import Outcome
    from salsanext_cli.runs.summary.run_summary import RunSummary


def next_command(
    outcome: Outcome, words: Iterable[Path | str], settings: Sequence[str] = ()
) -> str | None:
    """Return a command line of `salsanext`, quoted for a shell.

    Parameters
    ----------
    outcome : Outcome
        Outcome of the run before.
    words : iterable of Path or str
        Command and arguments.
    settings : sequence of str
        Options as `setting` spells them.

    Returns
    -------
    str or None
        None if the run has no results.
    """
    if not outcome.has_results:
        return None
    return command(shlex.join(["salsanext", *map(str, words)]), *settings)


def command_on_labels(outcome: Outcome, out: Path, split: str | None) -> str | None:
    """Return the command line that uses predicted labels; None if the run has no results.

    Parameters
    ----------
    outcome : Outcome
        Outcome of the run, with a summary.
    out : Path
        Folder of the labels.
    split : str, optional
        Split of the scans, if one was selected.

    Returns
    -------
    str or None
    """
    summary = outcome.summary
    if summary is None:
        return None
    if not summary.has_point_labels:
        return next_command(outcome, ["knn-refine", out])
    if summary.labelled:
        return next_command(outcome, ["eval", out])
    if split == "test" and _has_classes_of_benchmark(summary):
        return next_command(outcome, ["submit", out, "submission.zip"])
    return next_command(outcome, ["report", out])


def _has_classes_of_benchmark(summary: RunSummary) -> bool:
    """Return whether the labels of a run have the classes of the benchmark, none of them merged."""
    from salsanext_cli.runs.scans.selection import unmerged

    return summary.space is not None and not unmerged(summary.space, summary.scans[:1])
