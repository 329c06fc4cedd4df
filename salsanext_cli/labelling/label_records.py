# SPDX-License-Identifier: MIT
"""Imports of labels, their record, and label files that still hold the pre-labels of a network.

``ROOT/pick.json`` has the SHA-256 of each label file that `pick` wrote.
``ROOT/import-labels.jsonl`` has a line for each import of a scan, appended before its label file is
written: in an import that is cut off, the label file counts as what it was. Older versions wrote
``ROOT/import-labels.json``. A label file is a pre-label while it is as `pick` wrote it and was not
imported; copies of a data set are no exception.
"""

import hashlib
import json
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import LabelError, SalsanextError, counted
from salsanext_cli.files.atomic import append_line
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import MALFORMED, decoded, plain, read_json
from salsanext_cli.files.reading import present, reading
from salsanext_cli.measures.scan_summary import largest_classes
from salsanext_cli.measures.scores import Counts
from salsanext_cli.results.owned_folder import OwnedFolder, States
from salsanext_cli.results.paths import SCAN_FOLDER, ScanFile
from salsanext_cli.results.selection import data_set_of
from salsanext_cli.version import __version__

PICKED, GUESSES = "pick.json", "guesses"  # Record of `pick`, and its key for the digests
STAGE = "import-labels"
IMPORTED = (f"{STAGE}.json", f"{STAGE}.jsonl")  # Record of older versions, and that of this one


@dataclass(frozen=True, slots=True)
class ImportedScan:
    """Labels of one scan that were imported, in numbers of points."""

    scan: str  # Sequence and stem
    files: tuple[str, ...]  # Files that the labels came from
    points: int
    labelled: int  # Points with a class that counts, and the others with a label
    unlabelled: int
    ambiguous: int  # Points of several labels
    missing: int  # Points of the scan that no file has
    unmatched: int  # Points of the files that are none of the scan's
    contradicted: int  # Points that different files label differently
    scalar: str  # Names of the scalars that held the labels


@dataclass(frozen=True, slots=True)
class FailedImport:
    """Files that were not imported."""

    files: tuple[str, ...]
    reason: str
    hint: str
    code: str  # Of the error


@dataclass(frozen=True, slots=True)
class LabelOrigin:
    """Origin of the labels in a label file, as the record of imports has it."""

    sha256: str = ""  # Of the label file
    files: tuple[str, ...] = ("?",)  # Files that are not recorded may be any.
    contradicted: int = 0


@dataclass(slots=True)
class LabelImport:
    """Result of an import of labels."""

    space: LabelSpace  # Classes of the labels
    class_points: Counts  # (C,) int64: number of imported points by train id
    scans: list[ImportedScan] = field(default_factory=list)
    failures: list[FailedImport] = field(default_factory=list)
    # Files that hold the pre-labels of `pick`, all of them; they are not imported
    unedited: list[str] = field(default_factory=list)
    kept: int = 0  # Number of scans of the data set that keep the labels they have, or have none
    # Scans of the data set whose label file still holds pre-labels, as sequence/stem
    first_guesses: list[str] = field(default_factory=list)

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the labelled points, 0…1, of the largest classes, by name."""
        return largest_classes(self.space, np.where(self.space.scored, self.class_points, 0))

    def fail(self, files: Iterable[Path], error: SalsanextError) -> None:
        """Note files that are not imported."""
        self.failures.append(
            FailedImport(tuple(map(str, files)), error.headline, error.hint, error.code)
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        names = ("scans", "failures", "unedited", "kept", "first_guesses")
        found = {name: plain(getattr(self, name)) for name in names}
        return {"stage": STAGE, **found, "largest_classes": self.largest_classes()}


def labels_root(scan: ScanFile) -> Path:
    """Return the folder whose records tell of the labels of a scan: above scan and labels."""
    folder = scan.path.parent
    return data_set_of(scan) or (folder.parent if folder.name == SCAN_FOLDER else folder)


class LabelRecords:
    """Records of the labels of a data set, in its `labels_root`."""

    def __init__(self, root: Path) -> None:
        self.owned = OwnedFolder(root, STAGE)

    @cached_property
    def _guesses(self) -> Mapping[str, object]:
        return _table(self.owned.root / PICKED, GUESSES)

    @cached_property
    def _imported(self) -> dict[str, LabelOrigin]:
        older, lines = (self.owned.root / name for name in IMPORTED)
        entries = dict(_table(older, "scans"))
        if present(lines):
            with reading(lines) as file:
                for line in file:
                    with suppress(*MALFORMED):  # A line that was cut off says nothing.
                        entry = json.loads(line)
                        entries[entry["scan"]] = entry
        return {name: _origin(entry) for name, entry in entries.items()}

    @cached_property
    def _states(self) -> States:
        return self.owned.states()

    def is_guess(self, scan: ScanFile, digest: str) -> bool:
        """Say whether labels with a SHA-256 are those that a network guessed for a scan."""
        return self._guesses.get(scan.name) == digest

    def holds_guess(self, scan: ScanFile) -> bool:
        """Say whether the label file of a scan is still the first guess."""
        if scan.name not in self._guesses or not present(scan.label_path):
            return False
        digest = fingerprint(scan.label_path)
        imported = self._imported.get(scan.name)
        return self.is_guess(scan, digest) and not (imported and imported.sha256 == digest)

    def is_replaceable(self, scan: ScanFile, edited: Iterable[Path], contradicted: int = 0) -> bool:
        """Say whether the label file of a scan, if there is one, may give way to edited files."""
        path, earlier = scan.label_path, self._imported.get(scan.name, LabelOrigin(files=()))
        imported = Counter(Path(file).name for file in earlier.files)
        lost = imported - Counter(file.name for file in edited)
        more = imported and contradicted > earlier.contradicted
        if (lost or more) and present(path):
            return False
        changed = self.owned.foreign_files([path], self._states)
        return not changed or self.holds_guess(scan)

    def write(self, scan: ScanFile, content: bytes, imported: ImportedScan) -> None:
        """Write the imported label file of a scan, and record it and what is known about it."""
        digest = hashlib.sha256(content).hexdigest()
        line = json.dumps({"sha256": digest, "version": __version__, **plain(imported)})
        append_line(self.owned.root / IMPORTED[1], line.encode(), durable=True)
        self._imported[scan.name] = LabelOrigin(digest, imported.files, imported.contradicted)
        self.owned.write(scan.label_path, content, durable=True)


def first_guesses(scans: Iterable[ScanFile]) -> list[ScanFile]:
    """Return the scans whose label file is still the first guess of a network."""
    records: dict[Path, LabelRecords] = {}
    guesses = []
    for scan in scans:
        root = labels_root(scan)
        if records.setdefault(root, LabelRecords(root)).holds_guess(scan):
            guesses.append(scan)
    return guesses


def require_truth(scans: Iterable[ScanFile]) -> None:
    """Raise `LabelError` naming the first scan whose labels are a network's first guess."""
    if guesses := first_guesses(scans):
        more = f", as of {counted(len(guesses) - 1, 'other scan')}" if len(guesses) > 1 else ""
        found = f"a network's first guess, unchanged{more}"
        hint = "label the scan, then `salsanext import-labels`"
        raise LabelError(guesses[0].label_path, found, "labels by a person", hint)


def _origin(entry: object) -> LabelOrigin:
    with suppress(*MALFORMED):
        return decoded(LabelOrigin, entry)
    return LabelOrigin()


def _table(path: Path, key: str) -> Mapping[str, object]:
    table = (read_json(path) or {}).get(key)
    return table if isinstance(table, Mapping) else {}
