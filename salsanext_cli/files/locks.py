# SPDX-License-Identifier: MIT
"""Locks between processes and machines, which end with their process, and temporary folders."""

import errno
import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory

from filelock import FileLock, Timeout

from salsanext_cli.errors import OutputError, warn_once
from salsanext_cli.files.atomic import refusal
from salsanext_cli.files.reading import reason

UNSUPPORTED = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
"""Error numbers of file systems without locks."""

log = logging.getLogger(__name__)


@contextmanager
def locked(path: Path, timeout_s: float = 0.0, *, stage: str = "") -> Iterator[None]:
    """Lock a file, which is created and removed, while the body runs.

    On a file system without locks the body runs unlocked. The error names the `stage`, if any, that
    fills the folder.
    """
    lock = FileLock(path, timeout=timeout_s, fallback_to_soft=False)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        subject, problem, hint = path, "is locked by another process", "wait until it has ended"
        if stage:
            subject, problem = path.parent, f"is in use by another run of `{stage}`"
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


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Create a folder that is removed after the body."""
    with TemporaryDirectory(prefix="salsanext-") as name:
        yield Path(name)
