# SPDX-License-Identifier: MIT
"""Opening and looking for files that may be missing, unreadable, or no files at all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError


@contextmanager
def reading(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file for reading; whatever the system refuses becomes a `FormatError`."""
    try:
        # A pipe would block, and a device may never end.
        if not stat.S_ISREG(Path(path).stat().st_mode):
            raise FormatError(path, _kind(Path(path)), "a readable file")
        with Path(path).open("rb") as file:
            yield file
    except OSError as error:
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error


def _kind(path: Path) -> str:
    return "cannot be read: is a directory" if path.is_dir() else "neither a file nor a link to one"


def read_values(file: BinaryIO, path: Path, dtype: npt.DTypeLike, count: int) -> npt.NDArray[Any]:
    """Read so many values from where an open file stands.

    Raises
    ------
    FormatError
        If the file has become shorter since its size was asked for.
    """
    values = np.fromfile(file, dtype, count)
    if len(values) != count:
        raise FormatError(path, "changed while it was read", "a file that nobody writes to")
    return values


def present(path: Path) -> bool:
    """Say whether there is something under a name.

    A link to itself is something, which its reader refuses; a link to nothing is not.

    Raises
    ------
    FormatError
        If the system refuses to look: the name is too long, or a folder is not readable.
    """
    return _status(path) is not None


def filled(path: Path) -> bool:
    """Say whether there is a file under a name, and something in it.

    A power cut can leave a file empty that had just got its name. Raises what `present` raises.
    """
    status = _status(path)
    return status is not None and not stat.S_ISLNK(status.st_mode) and status.st_size > 0


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        if error.errno == errno.ELOOP:
            return path.lstat() if path.is_symlink() else None
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error


def is_folder(path: Path | os.DirEntry[str]) -> bool:
    """Say whether a name is that of a folder; a name that the system refuses is none.

    Such as a link to itself.
    """
    try:
        return path.is_dir()
    except OSError:
        return False


def reason(error: OSError) -> str:
    """Return the system's words for an error, without number and file name."""
    return (error.strerror or str(error)).lower()


def size_of(file: BinaryIO) -> int:
    """Return the size of an open file in bytes."""
    return os.fstat(file.fileno()).st_size
