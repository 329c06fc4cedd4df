# SPDX-License-Identifier: MIT
"""Locks between processes, also of several machines, and temporary folders.

Both end with the process that holds them.
"""

import errno
import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shutil import rmtree
from tempfile import TemporaryDirectory, gettempdir

from filelock import FileLock, Timeout

from salsanext_cli.errors import OutputError, warn_once
from salsanext_cli.files.atomic import refusal
from salsanext_cli.files.reading import reason

UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
"""Error numbers of file systems without locks."""
PREFIX, LOCK = ".salsanext-", ".lock"
"""Start of the names of temporary folders, and the file in each that its process has locked."""

STALE_AFTER_S = 3600.0  # Age of a lock's file from which on its folder may be removed

log = logging.getLogger(__name__)


@contextmanager
def locked(path: Path, timeout_s: float = 0.0, *, stage: str = "") -> Iterator[None]:
    """Hold the system's lock on a file, made and removed here, while the body runs.

    Without locks in the file system it runs all the same. A `stage` that fills the folder is named.
    """
    lock = FileLock(path, timeout=timeout_s, fallback_to_soft=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        subject, found, hint = path, "held by another process", "wait until it has ended"
        if stage:
            subject, found = path.parent, f"another run of `{stage}` is at work in it"
            hint += ", or use another folder"
        raise OutputError(subject, found, hint=hint) from error
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise refusal(path, error) from error
        why = f"output folders are not locked ({reason(error)})"
        warn_once(log, f"{why}: do not run two stages in one at a time")
        yield
        return
    try:
        yield
    finally:
        # Still held: who waits for it notices that the file has gone, and makes another.
        with suppress(OSError):
            path.unlink()
        lock.release()


@contextmanager
def temporary_folder(parent: Path | None = None) -> Iterator[Path]:
    """Make a folder that is gone after the body, by default in the system's temporary one.

    Those of killed processes, whose locks have ended for an hour or more, are removed first.
    """
    parent = parent or Path(gettempdir())
    # A folder without the file of a lock, or of a process that is about to lock it, stays.
    for path in parent.glob(f"{PREFIX}*/{LOCK}"):
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > STALE_AFTER_S:
                with FileLock(path, timeout=0, fallback_to_soft=False):
                    rmtree(path.parent)
    with TemporaryDirectory(prefix=PREFIX, dir=parent) as name:
        lock = FileLock(Path(name, LOCK), fallback_to_soft=False)
        with suppress(OSError):  # A file system without locks, where nothing is removed either.
            lock.acquire()
        try:
            yield Path(name)
        finally:
            lock.release()
