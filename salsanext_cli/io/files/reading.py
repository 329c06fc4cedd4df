# SPDX-License-Identifier: MIT
"""Opening of files, tests of their presence, and their identity, for any path."""

import hashlib
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.errors import FormatError, SalsanextError
from salsanext_cli.core.texts import error_text

PANIC = "PanicException"  # Error of libraries in Rust: a BaseException that cannot be imported


@contextmanager
def reading(path: Path | str) -> Iterator[BufferedReader]:
    """Open a file for reading; errors of the system become a `FormatError`."""
    try:
        # A pipe would block, and a device may never end.
        if not stat.S_ISREG(Path(path).stat().st_mode):
            kind = "a directory" if Path(path).is_dir() else "not a regular file"
            raise FormatError(path, f"cannot be read: is {kind}", "a readable file")
        with Path(path).open("rb") as file:
            yield file
    except OSError as error:
        raise _unreadable(path, error) from error


@contextmanager
def refusing_damage(path: Path, expected: str, hint: str = "") -> Iterator[None]:
    """Turn the errors of a library at a damaged file into a `FormatError`.

    Parameters
    ----------
    path : Path
        The file.
    expected : str
        Content that is required, in words.
    hint : str
        What the user can do.
    """
    try:
        yield
    except SalsanextError:
        raise
    except BaseException as error:
        is_of_library = isinstance(error, Exception) or type(error).__name__ == PANIC
        if not is_of_library or isinstance(error, MemoryError | NameError | ImportError):
            raise
        problem = f"is damaged or cut off: {error_text(error)}"
        if isinstance(error, OSError) and error.errno:  # of the system, not of a library
            problem = f"cannot be read: {reason(error)}"
        raise FormatError(path, problem, expected, hint) from error


def read_values(
    file: BufferedIOBase, path: Path, dtype: npt.DTypeLike, count: int
) -> npt.NDArray[Any]:
    """Read values from the current position of an open file that is long enough.

    Parameters
    ----------
    file : BufferedIOBase
        The open file.
    path : Path
        Its path, for errors.
    dtype : dtype
        Type of the values.
    count : int
        Number of values.

    Returns
    -------
    (count,) array
        Of the dtype.

    Raises
    ------
    FormatError
        If the file has become shorter.
    """
    values = np.empty(count * np.dtype(dtype).itemsize, np.uint8)
    if file.readinto(values.data) != len(values):
        raise FormatError(path, "changed while it was read", hint="wait until it is complete")
    return values.view(dtype)


def present(path: Path) -> bool:
    """Return whether a path exists; `FormatError` if the system refuses to answer."""
    return _status(path) is not None


def reachable(path: Path) -> bool:
    """Return whether a path exists and the system lets it be looked up; otherwise as if gone."""
    try:
        return present(path)
    except FormatError:
        return False


def filled(path: Path) -> bool:
    """Return whether a file exists and has content; a power cut can leave it empty."""
    status = _status(path)
    return status is not None and status.st_size > 0


def is_same_file(first: Path, second: Path) -> bool:
    """Return whether two paths lead to one existing file."""
    one = _status(first)
    other = _status(second)
    return one is not None and other is not None and os.path.samestat(one, other)


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise _unreadable(path, error) from error


def _unreadable(path: Path | str, error: OSError) -> FormatError:
    return FormatError(path, f"cannot be read: {reason(error)}", "a readable file")


def is_folder(path: Path | os.DirEntry[str]) -> bool:
    """Return whether a path is a folder; a link to itself or too long a path is not."""
    try:
        return path.is_dir()
    except OSError:
        return False


def reason(error: OSError) -> str:
    """Return the system's description of an error, without number and file name."""
    return (error.strerror or str(error)).lower()


def size_of(file: BufferedReader) -> int:
    """Return the size of an open file in bytes."""
    return os.fstat(file.fileno()).st_size


def bytes_at(path: Path) -> int:
    """Return the size of a file in bytes; 0 if there is none, or the system refuses to answer."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


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
