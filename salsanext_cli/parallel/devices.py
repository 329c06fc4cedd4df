# SPDX-License-Identifier: MIT
"""GPUs of worker processes: one for each as long as there are enough."""

from __future__ import annotations

import getpass
import hashlib
import logging
import os
import tempfile
from pathlib import Path

from salsanext_cli.parallel.worker import WORKER

log = logging.getLogger(__name__)


def own_device(device: str, gpus: int) -> str:
    """Return the device for this process: in a worker, "auto" and "cuda" become a GPU of its own.

    Workers beyond the number of GPUs share them evenly. A device that was named stays.

    Parameters
    ----------
    device : str
        As `load_network` takes it.
    gpus : int
        Number of visible ones.
    """
    if not WORKER.run or device not in ("auto", "cuda") or gpus < 2:
        return device
    if WORKER.slot is None:
        try:
            WORKER.slot = take_slot(_folder_of_slots())
        except (OSError, NotImplementedError) as error:
            log.warning("GPUs are shared by chance, since workers cannot be counted: %s", error)
            WORKER.slot = (os.getpid(), None)
    return f"cuda:{WORKER.slot[0] % gpus}"


def take_slot(folder: Path) -> tuple[int, object]:
    """Return the lowest number that no other process holds, from 0, and the lock on it.

    The system releases the lock when the process ends, however that ends.
    """
    from filelock import FileLock, Timeout

    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    number = 0
    while True:
        lock = FileLock(folder / str(number))
        try:
            lock.acquire(timeout=0)
        except Timeout:
            number += 1
        else:
            return number, lock


def _folder_of_slots() -> Path:
    """Return a folder of this user's; processes that see other GPUs are counted apart."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES", "")
    digest = hashlib.sha256(visible.encode()).hexdigest()[:12]
    return Path(tempfile.gettempdir()) / f"salsanext-gpus-{getpass.getuser()}-{digest}"
