# SPDX-License-Identifier: MIT
"""Watch of a worker over the failures of the others.

A worker that fails names its error in the store that all workers share, and the others end with one
line that repeats it. Without this, a worker in a collective prints a traceback about a lost
connection, and one that computes goes on until its next collective. `record` of torch's elastic
module changes neither: it writes the error for torchrun, which ends only workers of its machine.
"""

import logging
import os
import platform
import signal
import threading
import time
from contextlib import suppress
from typing import Any

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.texts import error_text

POLL_S = 0.1  # Time between two queries of the store
LEAVING_S = 0.5  # Time that a worker stays after its last message
FAILED = "failed"  # Key of the store: which worker failed, and why

log = logging.getLogger(__name__)


class FailureWatch:
    """Thread that ends this process after another worker has failed.

    Parameters
    ----------
    store : torch.distributed.Store
        Store that all workers share.
    rank : int
        Number of this worker.
    size : int
        Number of workers.
    """

    def __init__(self, store: Any, rank: int, size: int) -> None:
        self.store = store
        self.rank = rank
        self.size = size
        self._left = threading.Event()
        self._other_failed = threading.Event()

    def start(self) -> None:
        """Start to watch."""
        threading.Thread(target=self._watch, daemon=True).start()

    def leave(self) -> None:
        """Stop to watch: this worker ends by itself."""
        self._left.set()

    def report(self, error: BaseException) -> None:
        """Name the error of this worker to the others, unless it follows from theirs.

        An interrupt reaches all workers, and so does an error of the main worker's call. An error
        that another worker reports too is marked, so that it is printed once.
        """
        if self._other_failed.is_set():
            os._exit(1)  # noqa: TID251 - this error follows from the other worker's
        self.leave()
        if not (isinstance(error, KeyboardInterrupt) or _is_reported_elsewhere(error)):
            # The host of the store may be gone.
            with suppress(RuntimeError):
                self._name(error)
        if _is_reported_elsewhere(error):
            _await_the_reporting_worker()

    def _name(self, error: BaseException) -> None:
        """Store an error, unless another one is stored already."""
        cause = error_text(error)
        failure = f"worker {self.rank} of {self.size} on {platform.node()}: {cause}"
        first = self.store.compare_set(FAILED, "", failure).decode()
        if isinstance(error, SalsanextError):
            error.reported_elsewhere = first != failure and first.endswith(cause)

    def _watch(self) -> None:
        """Log that another worker has failed, and end this process, which may wait for it."""
        while not self._left.wait(POLL_S):
            failure = self._failure()
            if failure:
                self._other_failed.set()
                log.error("%s", failure)
                # No exception reaches a thread in a collective. The worker that failed ends first.
                time.sleep(10 * LEAVING_S)
                os._exit(1)  # noqa: TID251

    def _failure(self) -> str:
        """Return which worker failed, and why; empty if none did."""
        try:
            return self.store.get(FAILED).decode() if self.store.check([FAILED]) else ""
        except RuntimeError as error:
            return f"the connection to the first worker is lost: {error_text(error)}"


def _is_reported_elsewhere(error: BaseException) -> bool:
    return isinstance(error, SalsanextError) and error.reported_elsewhere


def _await_the_reporting_worker() -> None:
    """Stay until torchrun ends this process, which it does when the reporting worker has ended.

    If this worker ended first, torchrun would end the other one before it prints the error.
    """
    if threading.current_thread() is threading.main_thread():
        # The signal of torchrun ends the process without a further line.
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    time.sleep(10 * LEAVING_S)
