# SPDX-License-Identifier: MIT
"""Which GPU a worker uses: one of its own as long as there are enough."""

from __future__ import annotations

import getpass
import hashlib
import logging
import os
import tempfile
import threading
import weakref
from contextvars import ContextVar
from itertools import count
from pathlib import Path

log = logging.getLogger(__name__)

ONE_EACH: ContextVar[bool] = ContextVar("ONE_EACH", default=False)
"""Whether this is a worker, beside others that may use the same GPUs."""


class Slot:
    """The lowest number that no other worker on this machine holds, held until it ends.

    The system releases the lock when a process ends, however it ends, so that a worker that takes
    the place of a killed one takes its number too.

    Parameters
    ----------
    folder : Path
        Where the locks are; workers that count together share it.

    Attributes
    ----------
    number : int
        From 0.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        tries = ((number, _locked(folder / str(number))) for number in count())
        self.number, lock = next((number, lock) for number, lock in tries if lock is not None)
        weakref.finalize(self, os.close, lock)


def _locked(path: Path) -> int | None:
    """Lock a file and return its descriptor, None if somebody else holds it."""
    import fcntl

    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(descriptor)
        return None
    return descriptor


class _Held(threading.local):
    slot: Slot | None = None


_HELD = _Held()


def own_device(device: str, gpus: int) -> str:
    """Return the device for a worker: "auto" and "cuda" become a GPU of its own.

    Workers beyond the number of GPUs share them evenly. A device that was named stays.

    Parameters
    ----------
    device : str
        As `load_network` takes it.
    gpus : int
        How many are visible.
    """
    if not ONE_EACH.get() or device not in ("auto", "cuda") or gpus < 2:
        return device
    try:
        if _HELD.slot is None:
            _HELD.slot = Slot(_folder_of_locks())
        number = _HELD.slot.number
    except (ImportError, OSError) as error:
        number = os.getpid()
        log.warning("GPUs are divided by chance, since workers cannot count: %s", error)
    return f"cuda:{number % gpus}"


def _folder_of_locks() -> Path:
    """Return a folder of this user's; who sees other GPUs counts for himself."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    seen = hashlib.sha256(visible.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"salsanext-gpus-{getpass.getuser()}-{seen}"
