# SPDX-License-Identifier: MIT
"""Files that labelling tools have written, and the scans that they belong to."""

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from salsanext_cli.errors import LabelError, NoInputError, first_few
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats.label_scalars import READERS
from salsanext_cli.results.layout import ScanFile, counted_by_suffix

EDITED_SUFFIXES = (*READERS, ".label", ".npy")
"""Suffixes of files with labels, upper or lower case."""


def find_edited(source: Path) -> list[Path]:
    """Return a file with labels, or those in a folder and below it that are not hidden, sorted."""
    expected = f"labels: {', '.join(EDITED_SUFFIXES)} files"
    if not present(source):
        raise NoInputError(source, "no such file or folder", expected)
    if not is_folder(source):
        if not _is_edited(source):
            found = f"a {source.suffix} file" if source.suffix else "has no suffix"
            raise NoInputError(source, found, expected, "save it as .ply, in CloudCompare too")
        return [source.absolute()]
    files = sorted(_files_below(source.absolute()))
    edited = [path for path in files if _is_edited(path)]
    if not edited:
        others = f", but {counted_by_suffix(files)}" if files else ""
        raise NoInputError(source, f"holds no labels{others}", expected)
    return edited


def _is_edited(path: Path) -> bool:
    return path.suffix.lower() in EDITED_SUFFIXES


def _files_below(folder: Path) -> list[Path]:
    found = []
    for place, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        found += [Path(place, name) for name in names if not name.startswith(".")]
    return found


class ScanNames:
    """Scans of a data set by their stems, for `scan_of_edited`."""

    def __init__(self, scans: Sequence[ScanFile]) -> None:
        self.scans = scans
        self.sequences = {scan.sequence for scan in scans}
        self.of_stem: dict[str, list[ScanFile]] = {}
        for scan in scans:
            self.of_stem.setdefault(scan.stem, []).append(scan)

    def within(self, sequence: str | None, stems: Iterable[str]) -> list[ScanFile]:
        """Return the scans of some stems, in one sequence if it is named."""
        scans = [scan for stem in stems for scan in self.of_stem.get(stem, ())]
        fitting = [scan for scan in scans if sequence in (None, scan.sequence)]
        return sorted(fitting, key=lambda scan: (scan.sequence, scan.stem))


def scan_of_edited(path: Path, source: Path, names: ScanNames) -> ScanFile:
    """Return the scan that an edited file belongs to; `source` is the file or folder named for it.

    It is the only scan there is, if a single file was named; or the only one of that stem, or else
    whose stem is a whole word of the file's name, as in ``000010 - Cloud.ply``. If a folder tells
    the sequence, only its scans count; so it is if the name has that of a sequence as a word.
    """
    if not is_folder(source) and len(names.scans) == 1:
        return names.scans[0]
    sequence = _sequence_of(path, source, names.sequences)
    fitting = names.within(sequence, [path.stem]) or names.within(sequence, _words(path.stem))
    if len(fitting) > 1:
        fitting = [scan for scan in fitting if scan.sequence in _words(path.stem)] or fitting
    if len(fitting) == 1:
        return fitting[0]
    where = "" if sequence is None else f" in sequence {sequence}"
    several = first_few([f"{scan.sequence}/{scan.stem}" for scan in fitting])
    raise LabelError(
        path,
        f"may belong to {several}" if fitting else f"belongs to no scan{where}",
        "the name of one scan, alone or as a word, as in `000010 - Cloud.ply`",
        "put it into a folder with the name of its sequence" if fitting else "rename it",
    )


def _sequence_of(path: Path, source: Path, sequences: set[str]) -> str | None:
    """Return the sequence that a folder named, or below it or `sequences`, tells, None if none."""
    top = source.absolute()
    for folder in path.parents:
        if folder.parent.name == "sequences":
            return folder.name
        if folder.name in sequences and (folder == top or top in folder.parents):
            return folder.name
    return None


def _words(text: str) -> set[str]:
    """Return every part of a name that no letter or digit touches."""
    borders = range(len(text) + 1)
    starts = [i for i in borders if not text[:i][-1:].isalnum()]
    ends = [i for i in borders if not text[i:][:1].isalnum()]
    return {text[start:end] for start in starts for end in ends if start < end}
