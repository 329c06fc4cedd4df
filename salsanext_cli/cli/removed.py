# SPDX-License-Identifier: MIT
"""Commands and options of earlier versions, and what to use instead."""

from collections.abc import Sequence
from itertools import pairwise

from salsanext_cli.cli.console import guarded
from salsanext_cli.errors import UsageError

REMOVED = {
    ("picture", "--gif"): "use ffmpeg on the pictures, as docs/picture.md shows",
    ("picture", "--fps"): "use ffmpeg on the pictures, as docs/picture.md shows",
    ("pick", "--strategy"): "use no option: picked scans are uncertain and unlike each other",
    ("pick", "--disagreement"): "use no option: the uncertainty is that of the network",
    ("", "--backend ray"): "use `--shard I/N` on each machine",
    ("", "--backend dask"): "use `--shard I/N` on each machine",
    ("", "--scheduler"): "use `--shard I/N` on each machine",
    ("export-onnx", "--int8"): "quantise the exported model with other software",
    ("export-onnx", "--calibrate"): "quantise the exported model with other software",
    ("uncertainty", "--method"): "use fewer passes, such as `--samples 5`, to save time",
}
"""Remedy by command, "" for all commands, and option, with its value if other values remain."""


REMOVED_COMMANDS = {"export-rrd": "use examples/rerun_recording.py"}


@guarded
def refuse_removed_command(command: str, *, json: bool) -> None:
    """Refuse a command of earlier versions; `guarded` reads `json`."""
    if hint := REMOVED_COMMANDS.get(command):
        raise UsageError(command, "this command was removed", hint=hint)


@guarded
def refuse_removed(command: str, words: Sequence[str], *, json: bool) -> None:
    """Refuse an option that a command no longer has; `guarded` reads `json`."""
    parts = [part for word in words for part in word.split("=", 1)]
    given = {*parts, *map(" ".join, pairwise(parts))}
    for (name, option), hint in REMOVED.items():
        if name in ("", command) and option in given:
            raise UsageError(option, "this option was removed", hint=hint)
