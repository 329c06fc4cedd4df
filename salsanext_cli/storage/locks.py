# SPDX-License-Identifier: MIT
"""Locks between processes, also on several machines, that end with the process that holds them."""

from __future__ import annotations

import errno
import logging
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

from salsanext_cli.errors import OutputError
from salsanext_cli.formats.reading import reason
from salsanext_cli.storage.atomic import refusal

try:
    import fcntl
except ImportError:  # Windows
    fcntl = None  # type: ignore[assignment]

HELD = (errno.EAGAIN, errno.EACCES)
"""What the system answers while another holds the lock; anything else is no locking at all."""
PAUSE = 0.02
"""Seconds between two tries."""

log = logging.getLogger(__name__)


class Held(OutputError):  # noqa: N818 - the name says what is wrong
    """Another process holds the lock."""


@contextmanager
def locked(path: Path, *, shared: bool = False, patience: float = 0.0) -> Iterator[None]:
    """Hold a lock while the body runs; where the system has none, run it all the same.

    The lock is the system's, on an empty file that is made and removed here. It is released when
    the process dies, however it does; its file may stay then, and means nothing.

    Parameters
    ----------
    path : Path
        The file; its folder is made.
    shared : bool
        Whether others may hold it too who also share it.
    patience : float
        Seconds to wait for others.

    Raises
    ------
    Held
        If others still hold it then.
    OutputError
        If the file cannot be made.
    """
    handle = _acquire(path, shared, patience)
    try:
        yield
    finally:
        _release(handle, path)


def _acquire(path: Path, shared: bool, patience: float) -> int:
    """Return an open file that holds the lock and still has its name."""
    end = time.monotonic() + patience
    while True:
        handle = _open(path)
        try:
            free = _lock(handle, shared=shared)
            # Who held the lock until now has removed the file.
            if free and _names(path, handle):
                return handle
        except BaseException:
            os.close(handle)
            raise
        os.close(handle)
        if not free:
            if time.monotonic() >= end:
                raise Held(path, "held by another process", remedy="wait until it has ended")
            time.sleep(PAUSE)


def _open(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise refusal(path, error) from error


def _names(path: Path, handle: int) -> bool:
    """Whether a name is still that of an open file."""
    try:
        held = os.fstat(handle)
        return held.st_nlink > 0 and os.path.samestat(path.stat(), held)
    except OSError:
        return False


def _lock(handle: int, *, shared: bool) -> bool:
    """Lock an open file, or return False at once if others hold it."""
    if fcntl is None:
        _say_unlocked("the system has none")
        return True
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        if error.errno in HELD:
            return False
        _say_unlocked(reason(error))
    return True


@cache
def _say_unlocked(why: str) -> None:
    log.warning("output folders are not locked (%s): let no two runs fill one at a time", why)


def _release(handle: int, path: Path) -> None:
    """Let go; the last to do so removes the file."""
    try:
        if _lock(handle, shared=False) and _names(path, handle):
            with suppress(OSError):
                path.unlink()
    finally:
        os.close(handle)
