# SPDX-License-Identifier: MIT
"""Errors of a fusion beside results of an earlier one, with the command that replaces them."""

import shlex
from pathlib import Path

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.wording import argument, command, setting
from salsanext_cli.runs.results.output_run import OutputRun


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


def _overwriting(out: Path, target: Path, sequence: str) -> str:
    """Return the command that fuses a sequence again."""
    words = shlex.join(["salsanext", "fuse", str(out), str(target)])
    fuse = command(words, setting("sequences", sequence), setting("overwrite", True))
    return f"`{fuse}`"
