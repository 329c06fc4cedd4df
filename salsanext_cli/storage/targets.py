# SPDX-License-Identifier: MIT
"""Checks of the name of a file to be written, before work is done for it."""

from __future__ import annotations

from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.reading import present
from salsanext_cli.storage.atomic import require_writable, sweep_stale

SUFFIX = ".safetensors"


def require_target(target: Path, overwrite: bool) -> None:
    """Refuse a name for a weights file before work is done that would be lost.

    Raises
    ------
    OutputError
        If it has another suffix, exists and may not be overwritten, or its folder cannot be
        written to.
    """
    if target.suffix != SUFFIX:
        raise OutputError(target, f"suffix {target.suffix or 'missing'}", SUFFIX)
    require_absent(target, overwrite)
    require_writable(target.parent)
    sweep_stale(target.parent)


def require_absent(path: Path, overwrite: bool) -> None:
    """Raise `OutputError` if a file exists and may not be overwritten, or is a folder."""
    if present(path) and not overwrite:
        raise OutputError(path, "exists", remedy="use another name, or --overwrite")
    if path.is_dir():
        raise OutputError(path, "is a folder", "the name of a file")
