# SPDX-License-Identifier: MIT
"""Identity of a file: its digest, and its state on disk."""

import hashlib
from functools import cache
from pathlib import Path

from salsanext_cli.files.reading import reading


def fingerprint(path: Path) -> str:
    """Return the SHA-256 of the content of a file, hexadecimal."""
    return _fingerprint(path, identity(path))


def identity(path: Path) -> tuple[object, ...]:
    """Return path, inode, size and time of a file, which change with it; empty without a file."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return path.absolute(), status.st_ino, status.st_size, status.st_mtime_ns


@cache
def _fingerprint(path: Path, _: tuple[object, ...]) -> str:
    with reading(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
