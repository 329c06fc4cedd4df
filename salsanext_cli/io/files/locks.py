# SPDX-License-Identifier: MIT
"""Locks between processes and machines, which end with their process, and temporary folders."""

import errno
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import takewhile
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, gettempdir

from filelock import FileLock, Timeout

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.notices import warn_once
from salsanext_cli.io.files.atomic import refusal
from salsanext_cli.io.files.reading import reason

UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
"""Error numbers of file systems without locks."""

PREFIX = ".salsanext-"  # Start of the names of temporary folders
LOCK = ".lock"  # File in each of them that its process has locked
STALE_AFTER_S = 3600.0  # Age of a lock file from which its folder may be removed

log = logging.getLogger(__name__)


@contextmanager
def locked(path: Path, timeout_s: float = 0.0, *, stage: str = "") -> Iterator[None]:
    """Lock a file, which is created and removed, while the body runs.

    On a file system without locks the body runs unlocked.

    Parameters
    ----------
    path : Path
        The file.
    timeout_s : float
        Time to wait for another process, in seconds.
    stage : str
        Stage that fills the folder, for errors; empty for none.

    Raises
    ------
    OutputError
        If another process has locked it, or it cannot be created.
    """
    lock = FileLock(path, timeout=timeout_s, fallback_to_soft=False)
    try:
        _acquire(lock, path.parent)
    except Timeout as error:
        subject = path
        problem = "is locked by another process"
        hint = "wait until it has ended"
        if stage:
            subject = path.parent
            problem = f"is in use by another run of `{stage}`"
            hint += ", or use another folder"
        raise OutputError(subject, problem, hint=hint) from error
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise refusal(path, error) from error
        problem = f"output folders cannot be locked ({reason(error)})"
        warn_once(log, f"{problem}: do not run two stages in one folder at the same time")
        yield
        return
    try:
        yield
    finally:
        # While it is locked: waiting processes notice that it is gone and create another.
        with suppress(OSError):
            path.unlink()
        lock.release()


def _acquire(lock: FileLock, folder: Path) -> None:
    """Lock a file in a folder, which is created."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except FileNotFoundError:
        # Another process, which had created the folder too, has removed it as empty meanwhile.
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()


@contextmanager
def remove_if_empty(folder: Path) -> Iterator[None]:
    """Remove a folder, and folders above it, if the body created them and left them empty."""
    created = list(takewhile(lambda path: not os.path.lexists(path), (folder, *folder.parents)))
    try:
        yield
    finally:
        with suppress(OSError):
            for path in created:
                path.rmdir()


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Create a folder that is removed after the body, by default in the system's temporary one.

    Folders of killed processes, whose locks have been free for an hour, are removed first.
    """
    parent = parent or Path(gettempdir())
    # A folder without a lock file may belong to a process that is about to lock it.
    for path in parent.glob(f"{PREFIX}*/{LOCK}"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > STALE_AFTER_S:
                with FileLock(path, timeout=0, fallback_to_soft=False):
                    rmtree(path.parent)
    with TemporaryDirectory(prefix=PREFIX, dir=parent) as name:
        lock = FileLock(Path(name, LOCK), fallback_to_soft=False)
        with suppress(OSError):  # Without locks, nothing is removed either.
            lock.acquire()
        try:
            yield Path(name)
        finally:
            lock.release()
