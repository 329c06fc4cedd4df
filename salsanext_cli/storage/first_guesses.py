# SPDX-License-Identifier: MIT
"""First guesses: label files that a network made, for a person to correct; until then no truth.

``ROOT/first_guesses.json`` holds the SHA-256 of each, so that a file that was edited is no longer
one. A guess that was right from the start is accepted by taking it from the record.
"""

import hashlib
from collections.abc import Iterable, Mapping
from pathlib import Path

from salsanext_cli.errors import LabelError, counted
from salsanext_cli.formats.reading import present
from salsanext_cli.storage.files.json_files import encode_json, read_json
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.selection import data_set_of
from salsanext_cli.storage.written_files import WrittenFiles

RECORD = "first_guesses.json"


def record_first_guesses(root: Path, files: Iterable[ScanFile]) -> None:
    """Record that the label files of scans of a data set are first guesses, beside earlier ones."""
    _write(root, {**_recorded(root), **{_name(file): _digest(file.label_path) for file in files}})


def accept(root: Path, files: Iterable[ScanFile]) -> None:
    """Take scans of a data set from the record: their labels are a person's now."""
    accepted = {_name(file) for file in files}
    before = _recorded(root)
    if accepted & before.keys():
        _write(root, {name: each for name, each in before.items() if name not in accepted})


def first_guesses(files: Iterable[ScanFile]) -> list[ScanFile]:
    """Return the scans, of any data sets, whose labels are a network's first guess still."""
    recorded: dict[Path | None, Mapping[str, str]] = {None: {}}
    found = []
    for file in files:
        root = data_set_of(file)
        if root not in recorded:
            recorded[root] = _recorded(root) if root else {}
        digest = recorded[root].get(_name(file))
        if digest and present(file.label_path) and _digest(file.label_path) == digest:
            found.append(file)
    return found


def require_truth(files: Iterable[ScanFile]) -> None:
    """Raise `LabelError` naming the first scan whose labels are a network's first guess."""
    if guesses := first_guesses(files):
        more = f", as of {counted(len(guesses) - 1, 'other scan')}" if len(guesses) > 1 else ""
        found = f"a network's first guess, unchanged{more}"
        remedy = "label the scan, then `salsanext import-labels`"
        raise LabelError(guesses[0].label_path, found, "labels by a person", remedy)


def _name(file: ScanFile) -> str:
    return f"{file.sequence}/{file.stem}"


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _recorded(root: Path) -> dict[str, str]:
    values = (read_json(root / RECORD) or {}).items()
    return {name: digest for name, digest in values if isinstance(digest, str)}


def _write(root: Path, digests: Mapping[str, str]) -> None:
    WrittenFiles(root).write(root / RECORD, encode_json(digests), durable=True)
