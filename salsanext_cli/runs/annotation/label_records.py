# SPDX-License-Identifier: MIT
"""Records of imported labels, and label files that still contain the pre-labels of a network.

``ROOT/pick.json`` has the SHA-256 of each label file that `pick` wrote.
``ROOT/import-labels.jsonl`` has a line for each import of a scan, appended before its label file is
written, so that an interrupted import changes nothing. Older versions wrote
``ROOT/import-labels.json``. A label file is a pre-label while it is as `pick` wrote it and was not
imported, also in copies of a data set.
"""

import hashlib
import json
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import LabelError, SalsanextError
from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.core.plain_data import MALFORMED, decoded, plain
from salsanext_cli.core.texts import counted
from salsanext_cli.io.files.atomic import append_line
from salsanext_cli.io.files.json_files import read_json
from salsanext_cli.io.files.reading import fingerprint, present, reading
from salsanext_cli.runs.results.owned_folder import OwnedFolder, States
from salsanext_cli.runs.scans.layouts import PICK_RECORD, SCAN_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of
from salsanext_cli.runs.summary.run_counts import largest_classes
from salsanext_cli.version import __version__

PRE_LABELS = ("guesses", "pre_labels")  # Keys of the digests in it, of older versions and this one
STAGE = "import-labels"
IMPORTED = (f"{STAGE}.json", f"{STAGE}.jsonl")  # Record of older versions, and of this one


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedScan:
    """Imported labels of one scan, in numbers of points."""

    scan: str  # Sequence and stem
    files: tuple[str, ...]  # The edited file; in records of older versions possibly several
    points: int
    labelled: int  # Points with a class that is not ignored
    unlabelled: int  # Other points with a label
    ambiguous: int  # Points with several labels
    missing: int  # Points of the scan that are not in the file
    unmatched: int  # Points of the file that are not in the scan
    scalar: str  # Name of the label scalar
    tool: str = ""  # Labelling tool whose form the file has, if any


@dataclass(frozen=True, slots=True, kw_only=True)
class FailedImport:
    """Files that were not imported."""

    files: tuple[str, ...]
    reason: str
    hint: str
    code: str  # Of the error


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelOrigin:
    """Origin of the labels in a label file, from the record of imports."""

    sha256: str = ""  # Of the label file
    files: tuple[str, ...] = ()  # The edited file; empty if the record is damaged


@dataclass(slots=True, kw_only=True)
class LabelImport:
    """Result of an import of labels."""

    space: LabelSpace  # Classes of the labels
    class_points: Counts  # (C,) int64: number of imported points by train id
    scans: list[ImportedScan] = field(default_factory=list)
    failures: list[FailedImport] = field(default_factory=list)
    unedited: list[str] = field(default_factory=list)  # Files with unchanged pre-labels
    unchanged: int = 0  # Number of scans without an edited file
    # Scans whose label file still contains pre-labels, as sequence/stem
    pre_labelled: list[str] = field(default_factory=list)

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the labelled points, 0…1, of the largest classes, by name."""
        return largest_classes(self.space, np.where(self.space.scored, self.class_points, 0))

    def fail(self, files: Iterable[Path], error: SalsanextError) -> None:
        """Record files that are not imported."""
        paths = tuple(map(str, files))
        self.failures.append(
            FailedImport(files=paths, reason=error.headline, hint=error.hint, code=error.code)
        )

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        names = ("scans", "failures", "unedited", "unchanged", "pre_labelled")
        results = {name: plain(getattr(self, name)) for name in names}
        return {"stage": STAGE, **results, "largest_classes": self.largest_classes()}


def labels_root(scan: ScanFile) -> Path:
    """Return the folder, above scan and labels, with the records of the labels of a scan."""
    folder = scan.path.parent
    return data_set_of(scan) or (folder.parent if folder.name == SCAN_FOLDER else folder)


class LabelRecords:
    """Records of the labels of a data set, in its `labels_root`."""

    def __init__(self, root: Path) -> None:
        self.owned = OwnedFolder(root, STAGE)

    @cached_property
    def _pre_labels(self) -> dict[str, object]:
        tables = (_table(self.owned.root / PICK_RECORD, key) for key in PRE_LABELS)
        return {name: digest for table in tables for name, digest in table.items()}

    @cached_property
    def _imported(self) -> dict[str, LabelOrigin]:
        older, lines = (self.owned.root / name for name in IMPORTED)
        entries = dict(_table(older, "scans"))
        if present(lines):
            with reading(lines) as file:
                for line in file:
                    with suppress(*MALFORMED):  # A line that was cut off.
                        entry = json.loads(line)
                        entries[entry["scan"]] = entry
        origins = dict.fromkeys(entries, LabelOrigin())
        for name, entry in entries.items():
            with suppress(*MALFORMED):
                origins[name] = decoded(LabelOrigin, entry)
        return origins

    @cached_property
    def _states(self) -> States:
        return self.owned.states()

    def is_pre_label(self, scan: ScanFile, digest: str) -> bool:
        """Return whether a label file with a SHA-256 is the pre-label of a scan."""
        return self._pre_labels.get(scan.name) == digest

    def has_pre_label(self, scan: ScanFile) -> bool:
        """Return whether the label file of a scan is still its pre-label."""
        if scan.name not in self._pre_labels or not present(scan.label_path):
            return False
        digest = fingerprint(scan.label_path)
        imported = self._imported.get(scan.name)
        return self.is_pre_label(scan, digest) and not (imported and imported.sha256 == digest)

    def is_replaceable(self, scan: ScanFile, edited: Path) -> bool:
        """Return whether labels from an edited file may replace the label file of a scan, if any.

        Labels from a file of another name may be newer, or be of other parts of the scan.
        """
        origin = self._imported.get(scan.name)
        is_other = origin and {Path(file).name for file in origin.files} != {edited.name}
        if is_other and present(scan.label_path):
            return False
        changed = self.owned.foreign_files([scan.label_path], self._states)
        return not changed or self.has_pre_label(scan)

    def write(self, scan: ScanFile, content: bytes, imported: ImportedScan) -> None:
        """Record an import, and write the label file of the scan."""
        digest = hashlib.sha256(content).hexdigest()
        line = json.dumps({"sha256": digest, "version": __version__, **plain(imported)})
        append_line(self.owned.root / IMPORTED[1], line.encode(), durable=True)
        self._imported[scan.name] = LabelOrigin(sha256=digest, files=imported.files)
        self.owned.write(scan.label_path, content, durable=True)


def pre_labelled_scans(scans: Iterable[ScanFile]) -> list[ScanFile]:
    """Return the scans whose label file still contains the pre-labels of a network."""
    roots = {scan: labels_root(scan) for scan in scans}
    records = {root: LabelRecords(root) for root in {*roots.values()}}
    return [scan for scan, root in roots.items() if records[root].has_pre_label(scan)]


def require_truth(scans: Iterable[ScanFile]) -> None:
    """Raise `LabelError` if the labels of a scan are pre-labels."""
    if unlabelled := pre_labelled_scans(scans):
        more = f", like {counted(len(unlabelled) - 1, 'other file')}" if unlabelled[1:] else ""
        problem = f"contains unchanged pre-labels{more}"
        hint = "label the scan, then run `salsanext import-labels`"
        raise LabelError(unlabelled[0].label_path, problem, "labels by a person", hint)


def require_labels(scans: Sequence[ScanFile]) -> None:
    """Raise `LabelError` for the first scan without a label file, or with a pre-label."""
    missing = [scan for scan in scans if not scan.label_path.is_file()]
    if missing:
        problem = f"the label files of {counted(len(missing), 'scan')} are missing"
        raise LabelError(missing[0].label_path, problem, "one for every scan of the split")
    require_truth(scans)


def _table(path: Path, key: str) -> Mapping[str, object]:
    table = (read_json(path) or {}).get(key)
    return table if isinstance(table, Mapping) else {}
