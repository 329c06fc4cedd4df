# SPDX-License-Identifier: MIT
"""Scans of any sequences that nobody reads."""

from collections.abc import Iterable
from pathlib import Path

from salsanext_cli.runs.scans.scan_file import ScanFile


def scans_of(names: Iterable[tuple[str, int]]) -> list[ScanFile]:
    """Return scans by their sequences and numbers, in order."""
    return [
        ScanFile(sequence=sequence, stem=f"{number:06d}", path=Path(f"/{sequence}/{number}.bin"))
        for sequence, number in sorted(names)
    ]
