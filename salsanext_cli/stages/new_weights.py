# SPDX-License-Identifier: MIT
"""Whether a weights file may be written under a name."""

from __future__ import annotations

import uuid
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.atomic import writing
from salsanext_cli.formats.reading import present

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
    if present(target) and not overwrite:
        raise OutputError(target, "exists", remedy="use another name, or --overwrite")
    if target.is_dir():
        raise OutputError(target, "is a folder", "the name of a file")
    probe = target.with_name(f".{uuid.uuid4().hex}.probe")
    with writing(probe):
        pass
    probe.unlink()
