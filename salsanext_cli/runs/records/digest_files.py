# SPDX-License-Identifier: MIT
"""Digests of scans in files of their own, so that a person can read the record of a stage.

A record holds the name of such a file, which contains the SHA-256 of its digests. Records of early
versions hold the joined digests themselves. Only a comparison with scans reads the file.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.network.card import split_digests
from salsanext_cli.io.files.atomic import write_bytes
from salsanext_cli.io.files.reading import present, reading

NAME = re.compile(r"digests-([0-9a-f]{16})\.(digests|txt)")
Change = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class RecordedScans:
    """Scans that a record contains the digests of."""

    digests: frozenset[str] = frozenset()
    # File of the digests that is not there, so that no scan can be compared with them
    missing: Path | None = None

    @property
    def hint(self) -> str:
        """How to get the missing file back; empty if it is there."""
        if self.missing is None:
            return ""
        again = "or predict again with the same weights into this folder, or into another one"
        return f"copy the file from the folder that the results come from, {again}"


NO_SCANS = RecordedScans()


def require_digests(text: object) -> None:
    """Raise `ValueError` for a text that is neither joined digests nor the name of their file."""
    if not (isinstance(text, str) and NAME.fullmatch(text)):
        split_digests(text)


def with_files(settings: Mapping[Any, object], folder: Path) -> dict[str, object]:
    """Return settings with the names of files in place of digests; write the files durably."""

    def write(text: str) -> str:
        if NAME.fullmatch(text):
            return text
        path = folder / _name_of(text)
        lines = "".join(f"{digest}\n" for digest in split_digests(text)).encode("ascii")
        if not present(path) or path.read_bytes() != lines:
            write_bytes(path, lines, durable=True)
        return path.name

    return _changed(settings, write)


def with_names(settings: Mapping[Any, object]) -> dict[str, object]:
    """Return settings with the names of files in place of digests, to compare settings."""

    def name(text: str) -> str:
        named = NAME.fullmatch(text)
        return f"digests-{named[1]}.digests" if named else _name_of(text)

    return _changed(settings, name)


def without_names(settings: Mapping[Any, object]) -> dict[str, object]:
    """Return settings without the name of the file of the scans of the guarantee."""
    changed = dict(settings)
    guarantee = changed.get("guarantee")
    if isinstance(guarantee, dict) and NAME.fullmatch(str(guarantee.get("digests", ""))):
        changed["guarantee"] = guarantee | {"digests": ""}
    return changed


def digests_of_guarantee(settings: Mapping[Any, object]) -> str:
    """Return the digests of the scans of the guarantee, or the name of their file."""
    guarantee = settings.get("guarantee")
    return str(guarantee.get("digests", "")) if isinstance(guarantee, dict) else ""


def recorded_scans(text: str, record: Path) -> RecordedScans:
    """Return scans by their joined digests or the name of the file of their digests.

    Parameters
    ----------
    text : str
        Digests or name in the settings of a record.
    record : Path
        The record, in whose folder the file is.

    Returns
    -------
    RecordedScans

    Raises
    ------
    OutputError
        If the file contains other digests than its name states.
    """
    named = NAME.fullmatch(text)
    if named is None:
        return RecordedScans(frozenset(split_digests(text)))
    path = record.with_name(text)
    if not present(path):
        return RecordedScans(missing=path)
    with reading(path) as file:
        joined = file.read().replace(b"\n", b"").decode("ascii", "replace")
    if _sha_of(joined) != named[1]:
        problem = "contains other digests than its name states"
        hint = f"copy it from the folder that {record.name} comes from, or delete it"
        raise OutputError(path, problem, f"the file that {record.name} names", hint)
    return RecordedScans(frozenset(split_digests(joined)))


def names_files(settings: Mapping[Any, object]) -> bool:
    """Return whether settings contain the name of a file of digests."""
    return without_names(settings) != dict(settings) or bool(
        NAME.fullmatch(str(settings.get("trained_on", "")))
    )


def files_of(settings: Mapping[Any, object]) -> set[str]:
    """Return the names of the files of digests in settings."""
    names: set[str] = set()

    def note(text: str) -> str:
        if NAME.fullmatch(text):
            names.add(text)
        return text

    _changed(settings, note)
    return names


def _changed(settings: Mapping[Any, object], change: Change) -> dict[str, object]:
    """Return settings with changed digests of training scans and of scans of the guarantee."""
    changed = dict(settings)
    if isinstance(text := changed.get("trained_on"), str) and text:
        changed["trained_on"] = change(text)
    guarantee = changed.get("guarantee")
    if isinstance(guarantee, dict) and isinstance(text := guarantee.get("digests"), str):
        changed["guarantee"] = guarantee | {"digests": change(text) if text else ""}
    return changed


def _sha_of(joined: str) -> str:
    return hashlib.sha256(joined.encode()).hexdigest()[:16]


def _name_of(joined: str) -> str:
    return f"digests-{_sha_of(joined)}.digests"
