# SPDX-License-Identifier: MIT
"""Errors of a fusion beside results of an earlier one, with the command that replaces them."""

import os
import shlex
from dataclasses import replace
from itertools import count
from pathlib import Path

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.io.files.reading import present
from salsanext_cli.runs.drives.voting_places import OtherScan
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.query import DATASET_VARIABLE, ResultQuery
from salsanext_cli.runs.scans.selection import data_set_of


def other_drive(record: Path, single: OutputRun) -> OutputError:
    """Return the error of results with votes of other scans, or by other poses."""
    target = record.parents[2]
    sequence = record.parent.name
    problem = f"has other scans or poses than {single.root} has now"
    fused = _overwriting(single.root, target, sequence)
    hint = f"run {fused}, with {argument('poses')} if you used it"
    return OutputError(record, problem, hint=hint)


def earlier_fusion(single: OutputRun, target: Path, sequence: str) -> OutputError:
    """Return the error of results beside the labels of a fusion into another folder."""
    folders = " and ".join(f"{name}/" for name in sorted(single.folders))
    problem = f"has {folders} of sequence {sequence} from a fusion into another folder"
    fused = _overwriting(single.root, target, sequence)
    hint = f"run {fused} to replace them; the labels in the other folder stay"
    return OutputError(single.root, problem, hint=hint)


def other_scans(
    folder: Path, other: OtherScan, out: Path, target: Path, query: ResultQuery
) -> OutputError:
    """Return the error of scans that may be others than those of the results in a folder.

    Parameters
    ----------
    folder : Path
        Folder with results, `out` or `target`.
    other : OtherScan
        One of the scans.
    out, target : Path
        Folder with labels of single scans, and that of the fused labels.
    query : ResultQuery
        Choice of the scans and their data set.

    Returns
    -------
    OutputError
    """
    problem = f"has results of {other.before}, which is still there, not of {other.scan.path}"
    hint = f"omit {argument('dataset')} and {DATASET_VARIABLE}, which are for scans that are gone"
    again = _into_new_folder(out, target, query)
    if folder == target:
        hint = f"run {again}, with another folder for the fused labels"
    elif other.has_voted:
        hint = f"run {_with_votes(out, target, other)}, or {again} to compute the votes again"
    return OutputError(folder, problem, "the same scans", hint)


def _with_votes(out: Path, target: Path, other: OtherScan) -> str:
    """Return the command that fuses a sequence with the scans of its earlier votes."""
    before = replace(other.scan, path=other.before)
    data_set = data_set_of(before) or before.path.parent
    settings = [setting("dataset", data_set), setting("sequences", before.sequence)]
    words = shlex.join(["salsanext", "fuse", str(out), str(target)])
    return f"`{command(words, *settings)}`"


def _into_new_folder(out: Path, target: Path, query: ResultQuery) -> str:
    """Return the command that fuses the chosen sequences into a folder that is not there yet."""
    candidates = (Path(f"{os.path.normpath(target)}-{number}") for number in count(2))
    new = next(path for path in candidates if not present(path))
    settings: list[str] = []
    if query.dataset:
        settings.append(setting("dataset", query.dataset))
    if query.selection.sequences:
        settings.append(setting("sequences", ",".join(query.selection.sequences)))
    settings.append(setting("overwrite", True))
    words = shlex.join(["salsanext", "fuse", str(out), str(new)])
    return f"`{command(words, *settings)}`"


def _overwriting(out: Path, target: Path, sequence: str) -> str:
    """Return the command that fuses a sequence again."""
    words = shlex.join(["salsanext", "fuse", str(out), str(target)])
    fuse = command(words, setting("sequences", sequence), setting("overwrite", True))
    return f"`{fuse}`"
