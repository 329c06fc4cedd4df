# SPDX-License-Identifier: MIT
"""Options of earlier versions, and what to use instead."""

from collections.abc import Sequence
from itertools import pairwise

from salsanext_cli.cli.console import guarded
from salsanext_cli.errors import UsageError

REMOVED = {
    ("picture", "--gif"): "use ffmpeg on the pictures, as docs/how-to/picture.md shows",
    ("picture", "--fps"): "use ffmpeg on the pictures, as docs/how-to/picture.md shows",
    ("pick", "--strategy"): "use no option: picked scans are uncertain and unlike each other",
    ("pick", "--disagreement"): "use no option: the uncertainty is that of the network",
    ("", "--backend ray"): "use `--backend dask`, or `--shard I/N` for each machine",
    ("uncertainty", "--method"): "use fewer passes, such as `--samples 5`, to save time",
}
"""Remedy by command, "" for all commands, and option, with its value if other values remain."""


@guarded
def refuse_removed(command: str, words: Sequence[str], *, json: bool) -> None:
    """Refuse an option that a command no longer has; `guarded` reads `json`."""
    parts = [part for word in words for part in word.split("=", 1)]
    given = {*parts, *map(" ".join, pairwise(parts))}
    for (name, option), hint in REMOVED.items():
        if name in ("", command) and option in given:
            raise UsageError(option, "this option was removed", hint=hint)
