# SPDX-License-Identifier: MIT
"""Write a file whole or not at all: temporary name in the same folder, then rename."""

from __future__ import annotations

import errno
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from typing import BinaryIO

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.reading import reason

MARK: ContextVar[str] = ContextVar("MARK", default="")
"""What begins the temporary names of a process, so that `sweep` finds them when it was killed."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


@contextmanager
def writing(path: Path | str) -> Iterator[BinaryIO]:
    """Open a file for writing that appears under its name only when it is complete.

    Parent folders are made. If the body raises, Ctrl-C included, nothing is left behind and an
    older file of that name stays as it was. The body should do nothing but write.

    Raises
    ------
    OutputError
        If the system refuses: read-only folder, full disk, a file where a folder should be.
    """
    path = Path(path)
    # A process id would not do: machines of a cluster share the folder, not the ids.
    temporary = path.with_name(f".{MARK.get()}{uuid.uuid4().hex}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
        temporary.replace(path)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise _refusal(path, error) from error
        raise


def _refusal(path: Path, error: OSError) -> OutputError:
    found, expected = reason(error), "a folder that can be written to"
    remedy = "change its permissions or choose another output folder"
    if error.errno in FULL:
        remedy = "free some space or choose another output folder"
    elif error.errno in (errno.ENOTDIR, errno.EEXIST):
        files = (folder for folder in path.parents if folder.exists() and not folder.is_dir())
        found, expected = f"{next(files, path.parent)} is no folder", "a folder to write to"
        remedy = "move it or choose another output folder"
    elif error.errno == errno.EISDIR:
        found, expected = "there is a folder of that name", "a file or nothing"
        remedy = "move it or choose another name"
    return OutputError(path, f"cannot be written: {found}", expected, remedy)


def sweep(folder: Path, mark: str) -> None:
    """Remove the temporary files of killed processes that had set `MARK`."""
    for temporary in folder.glob(f".{mark}*.part"):
        with suppress(OSError):
            temporary.unlink()


def write_text(path: Path, text: str) -> None:
    """Write a text file, UTF-8, whole or not at all."""
    with writing(path) as file:
        file.write(text.encode("utf-8"))
