# SPDX-License-Identifier: MIT
"""Processes of this machine: not reached by signals, never longer alive than their parent."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Generator
from contextlib import contextmanager
from multiprocessing import resource_tracker

POLL_INTERVAL_S = 1.0


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, since this thread ends them.

    A process inherits the signals that the thread which starts it has blocked, so that holds too
    for workers that joblib starts later, from a thread of its own.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    from joblib.externals.loky.backend import resource_tracker as tracker_of_loky

    # Starting these lets the signals through again, so they are started before.
    tracker_of_loky.ensure_running()
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent(parent: int) -> None:
    """Let this process end within seconds of the process that started it, even while it is idle.

    A parent that is killed cannot end its workers.

    Parameters
    ----------
    parent : int
        Process id.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(POLL_INTERVAL_S)
        os._exit(1)

    threading.Thread(target=watch, name="end-with-parent", daemon=True).start()
