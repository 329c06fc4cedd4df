# SPDX-License-Identifier: MIT
"""Imports of labels, their record, and label files that still hold the first guess of a network.

``ROOT/pick.json`` has the SHA-256 of each label file that `pick` wrote, and
``ROOT/import-labels.json`` that of each imported one, by sequence/scan. A label file is a first
guess while it is as `pick` wrote it and was not imported; copies of a data set are no exception.
"""

import hashlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import LabelError, SalsanextError, counted
from salsanext_cli.files.identity import fingerprint
from salsanext_cli.files.json_files import encode_json, read_json
from salsanext_cli.files.reading import present
from salsanext_cli.measures.scan_summary import largest_classes
from salsanext_cli.measures.scores import Counts
from salsanext_cli.results.layout import SCAN_FOLDER, ScanFile
from salsanext_cli.results.owned_folder import OwnedFolder, States
from salsanext_cli.results.selection import data_set_of
from salsanext_cli.version import __version__

PICKED, GUESSES = "pick.json", "guesses"  # Record of `pick`, and its key for the digests
STAGE = "import-labels"
IMPORTED = f"{STAGE}.json"


@dataclass(slots=True)
class LabelImport:
    """Result of an import of labels."""

    space: LabelSpace  # Classes of the labels
    class_points: Counts  # (C,) int64: number of imported points by train id
    # Of each imported scan: `scan` as sequence/stem, its `files`, `scalar`, number of `points`,
    # `labelled`, `unlabelled`, `ambiguous`, `missing` and `unmatched`, as `edited_labels` has them
    scans: list[dict[str, Any]] = field(default_factory=list)
    # What was not imported: `files`, `reason` and `code` of the error
    failures: list[dict[str, Any]] = field(default_factory=list)
    # Files that hold the first guess of `pick`, all of it; they are not imported
    unedited: list[str] = field(default_factory=list)
    kept: int = 0  # Number of scans of the data set that keep the labels they have, or have none
    # Scans of the data set whose label file is still the first guess, as sequence/stem
    first_guesses: list[str] = field(default_factory=list)

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the labelled points, 0…1, of the largest classes, by name."""
        return largest_classes(self.space, np.where(self.space.scored, self.class_points, 0))

    def fail(self, files: Iterable[Path], error: SalsanextError) -> None:
        """Note files that are not imported."""
        named = {"files": [str(path) for path in files]}
        self.failures.append(named | {"reason": str(error), "code": error.code})

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        names = ("scans", "failures", "unedited", "kept", "first_guesses")
        found = {name: getattr(self, name) for name in names}
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
    def _guesses(self) -> dict[str, Any]:
        return _table(self.owned.root / PICKED, GUESSES)

    @cached_property
    def _imported(self) -> dict[str, dict[str, Any]]:
        return _table(self.owned.record_path, "scans")

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
        confirmed = self._imported.get(scan.name, {}).get("sha256") == digest
        return self.is_guess(scan, digest) and not confirmed

    def is_replaceable(self, scan: ScanFile, edited: Iterable[Path], contradicted: int = 0) -> bool:
        """Say whether the label file of a scan, if there is one, may give way to edited files."""
        path, earlier = scan.label_path, self._imported.get(scan.name, {"files": []})
        # Files that are not recorded may be any.
        imported = Counter(Path(file).name for file in earlier.get("files", ["?"]))
        lost = imported - Counter(file.name for file in edited)
        more = imported and contradicted > earlier.get("contradicted", 0)
        if (lost or more) and present(path):
            return False
        changed = self.owned.foreign_files([path], self._states)
        return not changed or self.holds_guess(scan)

    def write(self, scan: ScanFile, content: bytes, about: Mapping[str, Any]) -> None:
        """Write the imported label file of a scan, and record it and what is known about it."""
        digest = hashlib.sha256(content).hexdigest()
        self._imported[scan.name] = {"sha256": digest, **about}
        scans = dict(sorted(self._imported.items()))
        record = {"stage": STAGE, "version": __version__, "scans": scans}
        # Where this is cut off in between, the label file counts as what it was.
        self.owned.write(self.owned.record_path, encode_json(record), durable=True)
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
        remedy = "label the scan, then `salsanext import-labels`"
        raise LabelError(guesses[0].label_path, found, "labels by a person", remedy)


def _table(path: Path, key: str) -> dict[str, Any]:
    table = (read_json(path) or {}).get(key)
    return dict(table) if isinstance(table, Mapping) else {}
