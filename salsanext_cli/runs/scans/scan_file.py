# SPDX-License-Identifier: MIT
"""A scan on disk: its sequence, its name, its path, and the path of its labels."""

import re
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import OutputError
from salsanext_cli.io.files.reading import present
from salsanext_cli.runs.scans.layouts import LABEL_FOLDER, SCAN_FOLDER, layout_of


@dataclass(frozen=True, slots=True, order=True, kw_only=True)
class ScanFile:
    """One scan on disk; sorted by sequence and stem."""

    sequence: str  # Name of its sequence
    stem: str  # File name without suffix; unique within the sequence
    path: Path  # Absolute; for a scan in a recording, the recording with topic and time

    @property
    def name(self) -> str:
        """Sequence and stem, ``08/000000``, the name in records and messages."""
        return f"{self.sequence}/{self.stem}"

    @property
    def suffix(self) -> str:
        """What follows the stem in the name of the file; empty for a scan in a recording."""
        return self.path.name[len(self.stem) :]

    @property
    def label_path(self) -> Path:
        """Path of the labels of the scan, which may not exist."""
        name = f"{self.stem}.label"
        folder = self.path.parent
        if folder.name == SCAN_FOLDER:
            return folder.parent / LABEL_FOLDER / name
        nested = folder / LABEL_FOLDER / name
        beside = folder / name
        layout = layout_of(folder, [self.path.name])
        apart = layout.label_path(folder, self.stem) if layout else None
        if apart and (present(apart) or not (present(nested) or present(beside))):
            return apart
        return nested if present(nested) else beside


def drive_order(file: ScanFile) -> tuple[Any, ...]:
    """Return a key that sorts scan 10 of a drive after scan 9."""
    words = re.split(r"(\d+)", file.stem)
    return file.sequence, [int(word) if word.isdecimal() else word for word in words], file.stem


def require_unique_stems(scans: list[ScanFile]) -> None:
    """Refuse several scans of one name among sorted scans."""
    for name, group in groupby(scans, lambda scan: scan.name):
        paths = [scan.path for scan in group]
        if len(paths) > 1:
            problem = f"{len(paths)} files of this name: {', '.join(map(str, paths))}"
            raise OutputError(name, problem, "one file per scan", "move or rename the others")
