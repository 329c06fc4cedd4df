# SPDX-License-Identifier: MIT
"""Opening of files and tests for their presence, where names may be anything."""

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedIOBase, BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError, SalsanextError, error_text

NO_FILE = "neither a file nor a link to one"
PANIC = "PanicException"  # Error of libraries in Rust, no `Exception`, whose class no module has


@contextmanager
def reading(path: Path | str) -> Iterator[BufferedReader]:
    """Open a file for reading; whatever the system refuses becomes a `FormatError`."""
    try:
        # A pipe would block, and a device may never end.
        if not stat.S_ISREG(Path(path).stat().st_mode):
            kind = "cannot be read: is a directory" if Path(path).is_dir() else NO_FILE
            raise FormatError(path, kind, "a readable file")
        with Path(path).open("rb") as file:
            yield file
    except OSError as error:
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error


@contextmanager
def refusing_damage(path: Path, expected: str, hint: str = "") -> Iterator[None]:
    """Turn whatever a library raises at a damaged file into a `FormatError`."""
    try:
        yield
    except SalsanextError:
        raise
    except BaseException as error:
        if isinstance(error, MemoryError | NameError | ImportError) or (
            not isinstance(error, Exception) and type(error).__name__ != PANIC
        ):
            raise
        found = f"damaged or cut off: {error_text(error)}"
        if isinstance(error, OSError) and error.errno:  # of the system, not of a library
            found = f"cannot be read: {reason(error)}"
        raise FormatError(path, found, expected, hint) from error


def read_values(
    file: BufferedIOBase, path: Path, dtype: npt.DTypeLike, count: int
) -> npt.NDArray[Any]:
    """Read values (count,) from the current position of an open file that holds as many."""
    values = np.empty(count * np.dtype(dtype).itemsize, np.uint8)
    if file.readinto(values.data) != len(values):
        raise FormatError(path, "changed while it was read", "a file that no program is writing")
    return values.view(dtype)


def present(path: Path) -> bool:
    """Return whether a name exists; `FormatError` where the system does not say."""
    return _status(path) is not None


def filled(path: Path) -> bool:
    """Return whether a name is that of a file with content; a power cut can leave it empty."""
    status = _status(path)
    return status is not None and status.st_size > 0


def _status(path: Path) -> os.stat_result | None:
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except OSError as error:
        raise FormatError(path, f"cannot be read: {reason(error)}", "a readable file") from error


def is_folder(path: Path | os.DirEntry[str]) -> bool:
    """Return whether a name is that of a folder; a link to itself or too long a name is not."""
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
