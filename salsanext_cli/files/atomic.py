# SPDX-License-Identifier: MIT
"""Write a file whole or not at all: temporary name in the same folder, then rename."""

import errno
import os
import re
import uuid
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO

from salsanext_cli.errors import OutputError
from salsanext_cli.files.reading import present, reason

MARK: ContextVar[str] = ContextVar("MARK", default=uuid.uuid4().hex)
"""Prefix of the temporary names of a run, so that `sweep` finds those of its killed workers."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
TEMPORARY = re.compile(r"\.(?:[0-9a-f]{32}){1,2}\.part")  # Names of unfinished files
STALE_AFTER_S = 24 * 3600.0  # Without a change for so long, the writer of a file must be dead
WEIGHTS_SUFFIX = ".safetensors"


@contextmanager
def writing(
    path: Path | str,
    *,
    durable: bool = False,
    overwrite: bool = True,
    before_rename: Callable[[os.stat_result], object] | None = None,
) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name, or replaces an older file, only when it is whole.

    A `durable` file survives a power cut; without `overwrite`, a file that got the name meanwhile
    raises `OutputError`; `before_rename` is called with the status of the whole file.
    """
    path = Path(path)
    # A process id would not do: machines of a cluster share the folder, not the ids.
    temporary = path.with_name(f".{MARK.get()}{uuid.uuid4().hex}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with temporary.open("xb") as file:
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        if before_rename:
            before_rename(temporary.stat())
        if not overwrite:
            require_absent(path, overwrite)
        temporary.replace(path)
        if durable:
            _keep_names(path.parent)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise refusal(path, error) from error
        raise


def _keep_names(folder: Path) -> None:
    """Let the names in a folder survive a power cut, where the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def require_writable(folder: Path) -> None:
    """Raise `OutputError` if no file can be written into a folder, which is made."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise refusal(folder, error) from error


def require_target(target: Path, overwrite: bool, suffix: str = WEIGHTS_SUFFIX) -> None:
    """Refuse a name for a file of weights before work is done that would be lost."""
    if target.suffix != suffix:
        raise OutputError(target, f"suffix {target.suffix or 'missing'}", suffix)
    require_absent(target, overwrite)
    require_writable(target.parent)
    sweep_stale(target.parent)


def require_absent(path: Path, overwrite: bool) -> None:
    """Raise `OutputError` if a file exists and may not be overwritten, or is a folder."""
    if present(path) and not overwrite:
        raise OutputError(path, "exists", hint="use another name, or --overwrite")
    if path.is_dir():
        raise OutputError(path, "is a folder", "the name of a file")


def refusal(path: Path, error: OSError) -> OutputError:
    """Return the error that says why the system refuses to write a file, and what to do."""
    way = "free some space" if error.errno in FULL else "change its permissions or what is there"
    hint = f"{way} or choose another output folder"
    found = f"cannot be written: {reason(error)}"
    return OutputError(path, found, "a folder that can be written to", hint)


def sweep(folder: Path, mark: str) -> None:
    """Remove the temporary files of killed processes that had set `MARK`."""
    for temporary in folder.glob(f".{mark}*.part"):
        with suppress(OSError):
            temporary.unlink()


def sweep_stale(folder: Path) -> None:
    """Remove the temporary files that nobody has touched for a day, by the clock of the disk."""
    with suppress(OSError):
        found = [path for path in folder.iterdir() if TEMPORARY.fullmatch(path.name)]
        if not found:
            return
        with TemporaryFile(dir=folder) as probe:
            now = os.fstat(probe.fileno()).st_mtime
        for temporary in found:
            with suppress(OSError):
                if now - temporary.stat().st_mtime > STALE_AFTER_S:
                    temporary.unlink()


def write_bytes(path: Path, content: bytes, *, durable: bool = False) -> None:
    """Write a file whole or not at all."""
    with writing(path, durable=durable) as file:
        file.write(content)


def append_line(path: Path, line: bytes, *, durable: bool = False) -> None:
    """Append a line to a file that other processes append to as well, or raise `OutputError`."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        # Unbuffered, it is one write, and those of other processes do not mix with it. The line
        # end comes first too: the line before may have been cut off.
        with path.open("ab", buffering=0) as file:
            if file.write(content := b"\n" + line + b"\n") != len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if durable:
                os.fsync(file.fileno())
    except OSError as error:
        raise refusal(path, error) from error
