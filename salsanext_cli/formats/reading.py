# SPDX-License-Identifier: MIT
"""Open a file that may be missing, a folder, or not ours to read."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from salsanext_cli.errors import FormatError


@contextmanager
def reading(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file for reading; whatever the system refuses becomes a `FormatError`."""
    try:
        with Path(path).open("rb") as file:
            yield file
    except OSError as error:
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error


def present(path: Path) -> bool:
    """Say whether there is something under a name.

    Raises
    ------
    FormatError
        If the system does not even let us look: the name is too long, a folder is not ours.
    """
    try:
        path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    except OSError as error:
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error
    return True


def reason(error: OSError) -> str:
    """Return the system's words for an error, without number and file name."""
    return (error.strerror or str(error)).lower()


def size_of(file: BinaryIO) -> int:
    """Return the size of an open file in bytes."""
    return os.fstat(file.fileno()).st_size
