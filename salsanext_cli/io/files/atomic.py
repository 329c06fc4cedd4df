# SPDX-License-Identifier: MIT
"""Atomic writing of files: a temporary name in the same folder, then rename."""

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

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import is_folder, present, reason

MARK: ContextVar[str] = ContextVar("MARK", default=uuid.uuid4().hex)
"""Prefix of the temporary names of a run, by which `sweep` removes those of killed workers."""
GUARD: ContextVar[Callable[[], object]] = ContextVar("GUARD", default=lambda: None)
"""Called before a complete file gets its name; it raises an exception if the file may not."""
FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
TEMPORARY = re.compile(r"\.(?:[0-9a-f]{32}){1,2}\.part")  # Names of unfinished files
STALE_AFTER_S = 24 * 3600.0  # Age of a temporary file whose writer must have ended
WEIGHTS_SUFFIX = ".safetensors"


@contextmanager
def writing(
    path: Path | str,
    *,
    durable: bool = False,
    overwrite: bool = True,
    before_rename: Callable[[os.stat_result], object] | None = None,
) -> Iterator[BinaryIO]:
    """Open a file for writing that gets its name, or replaces an older file, when it is complete.

    Parameters
    ----------
    path : Path or str
        Name of the complete file.
    durable : bool
        Whether the file must survive a power cut.
    overwrite : bool
        Whether it may replace a file that got the name meanwhile.
    before_rename : callable, optional
        Called with the status of the complete file.

    Yields
    ------
    BinaryIO
        The open file.

    Raises
    ------
    OutputError
        If the system refuses to write it, or it may not replace another.
    """
    path = Path(path)
    # Process ids are not unique: machines of a cluster share the folder.
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
        GUARD.get()()
        temporary.replace(path)
        if durable:
            _sync_names(path.parent)
    except BaseException as error:
        with suppress(OSError):
            temporary.unlink()
        if isinstance(error, OSError):
            raise refusal(path, error) from error
        raise


def make_durable(path: Path) -> None:
    """Make the content of a complete file survive a power cut; raise an `OSError` if it cannot."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


def _sync_names(folder: Path) -> None:
    """Make the names in a folder survive a power cut, if the system can."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def require_writable(folder: Path) -> None:
    """Create a folder; raise `OutputError` if no file can be written into it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=folder).close()
    except OSError as error:
        raise refusal(folder, error) from error


def foresee_writable(folder: Path) -> None:
    """Raise `OutputError` if a file, permissions or its name prevent a folder; write nothing."""
    try:
        place = next(filter(_is_taken, (folder, *folder.parents)))
    except OSError as error:
        raise refusal(folder, error) from error
    if not is_folder(place):
        number = errno.ENOTDIR
    elif not os.access(place, os.W_OK | os.X_OK):
        number = errno.EACCES
    else:
        return
    raise refusal(folder, OSError(number, os.strerror(number)))


def _is_taken(path: Path) -> bool:
    """Return whether anything has a name, also a link to nothing."""
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        return False
    return True


def require_target(target: Path, overwrite: bool, suffix: str = WEIGHTS_SUFFIX) -> None:
    """Refuse the name of a result before the work for it begins.

    Parameters
    ----------
    target : Path
        Name of the result.
    overwrite : bool
        Whether it may replace a file.
    suffix : str
        Suffix that the name must have.

    Raises
    ------
    OutputError
        If the suffix is another one, the file exists, or its folder cannot be written.
    """
    if target.suffix != suffix:
        problem = f"has the suffix {target.suffix}" if target.suffix else "has no suffix"
        raise OutputError(target, problem, suffix)
    require_absent(target, overwrite)
    require_writable(target.parent)
    sweep_stale(target.parent)


def require_absent(path: Path, overwrite: bool) -> None:
    """Raise `OutputError` if a file exists and may not be overwritten, or is a folder."""
    if present(path) and not overwrite:
        hint = f"use another name, or {setting('overwrite', True)}"
        raise OutputError(path, "already exists", hint=hint)
    if path.is_dir():
        raise OutputError(path, "is a folder", "a file")


def refusal(path: Path, error: OSError) -> OutputError:
    """Return the error of a file that the system refuses to write."""
    way = "free some space" if error.errno in FULL else "change its permissions"
    problem = f"cannot be written: {reason(error)}"
    hint = f"{way} or choose another output folder"
    return OutputError(path, problem, "a writable folder", hint)


def sweep(folder: Path, mark: str) -> None:
    """Remove the temporary files of killed processes that had set `MARK`."""
    for temporary in folder.glob(f".{mark}*.part"):
        with suppress(OSError):
            temporary.unlink()


def sweep_stale(folder: Path) -> None:
    """Remove the temporary files that have not changed for a day, by the clock of the disk."""
    with suppress(OSError):
        unfinished = [path for path in folder.iterdir() if TEMPORARY.fullmatch(path.name)]
        if not unfinished:
            return
        with TemporaryFile(dir=folder) as probe:
            now = os.fstat(probe.fileno()).st_mtime
        for temporary in unfinished:
            with suppress(OSError):
                if now - temporary.stat().st_mtime > STALE_AFTER_S:
                    temporary.unlink()


def write_bytes(path: Path, content: bytes, *, durable: bool = False) -> None:
    """Write a file atomically."""
    with writing(path, durable=durable) as file:
        file.write(content)


def write_target(path: Path, content: bytes, *, overwrite: bool) -> None:
    """Write a file that the user named, durably; `overwrite`: whether it may replace another.

    `require_target` refuses before the work begins; a file may get the name during the work.
    """
    require_absent(path, overwrite)
    with writing(path, durable=True, overwrite=overwrite) as file:
        file.write(content)


@contextmanager
def appending(path: Path, *, durable: bool = False) -> Iterator[Callable[[bytes], None]]:
    """Open a file that other processes append to as well.

    Parameters
    ----------
    path : Path
        The file, which is created if it is missing.
    durable : bool
        Whether what is appended must survive a power cut.

    Yields
    ------
    callable
        Function that appends bytes by one unbuffered write, which does not mix with those of other
        processes.

    Raises
    ------
    OutputError
        If the system refuses to write the file.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        file = path.open("ab", buffering=0)
    except OSError as error:
        raise refusal(path, error) from error

    def append(content: bytes) -> None:
        try:
            if file.write(content) != len(content):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            if durable:
                os.fsync(file.fileno())
        except OSError as error:
            raise refusal(path, error) from error

    with file:
        yield append


def append_line(path: Path, line: bytes, *, durable: bool = False) -> None:
    """Append a line to a file that other processes append to as well, or raise `OutputError`."""
    with appending(path, durable=durable) as append:
        # A line end comes first, too: the line before may have been cut off.
        append(b"\n" + line + b"\n")
