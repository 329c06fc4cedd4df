# SPDX-License-Identifier: MIT
"""Digests of scans in files of their own, so that a person can read the record of a stage.

A record holds the name of such a file, which contains the SHA-256 of its digests. Records of early
versions hold the joined digests themselves.
"""

import hashlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from salsanext_cli.errors import OutputError
from salsanext_cli.files.atomic import write_bytes
from salsanext_cli.files.reading import present, reading
from salsanext_cli.network.card import parted

NAME = re.compile(r"digests-([0-9a-f]{16})\.digests")
Change = Callable[[str], str]


def with_files(settings: Mapping[Any, object], folder: Path) -> dict[str, object]:
    """Return settings with the names of files in place of digests; write the files durably."""

    def write(digests: str) -> str:
        path = folder / _name_of(digests)
        lines = "".join(f"{digest}\n" for digest in parted(digests))
        write_bytes(path, lines.encode("ascii"), durable=True)
        return path.name

    return _changed(settings, write)


def with_digests(settings: Mapping[Any, object], record: Path) -> dict[str, object]:
    """Return settings with digests in place of the names of files.

    Parameters
    ----------
    settings : mapping
        Settings in the record of a stage.
    record : Path
        The record, in whose folder the files are.

    Returns
    -------
    dict

    Raises
    ------
    OutputError
        If a file is missing, or contains other digests than its name states.
    """

    def read(name: str) -> str:
        return _read(record, name) if NAME.fullmatch(name) else name

    return _changed(settings, read)


def _changed(settings: Mapping[Any, object], change: Change) -> dict[str, object]:
    """Return settings with changed digests of training scans and of scans of the guarantee."""
    changed = dict(settings)
    if isinstance(digests := changed.get("trained_on"), str) and digests:
        changed["trained_on"] = change(digests)
    guarantee = changed.get("guarantee")
    if isinstance(guarantee, dict) and isinstance(digests := guarantee.get("digests"), str):
        changed["guarantee"] = guarantee | {"digests": change(digests) if digests else ""}
    return changed


def _name_of(digests: str) -> str:
    return f"digests-{hashlib.sha256(digests.encode()).hexdigest()[:16]}.digests"


def _read(record: Path, name: str) -> str:
    path = record.with_name(name)
    hint = f"copy {name} from the folder that {record.name} comes from, or use another folder"
    if not present(path):
        raise OutputError(path, "is missing", f"a file that {record.name} names", hint)
    with reading(path) as file:
        digests = file.read().replace(b"\n", b"").decode("ascii", "replace")
    if _name_of(digests) != name:
        problem = "contains other digests than its name states"
        raise OutputError(path, problem, f"the file that {record.name} names", hint)
    return digests
