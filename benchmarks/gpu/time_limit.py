# SPDX-License-Identifier: MIT
"""Limit on the time of a part of a run, which ends whatever the part does then."""

import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager

AGAIN_S = 2.0  # Interval of further interruptions, if a measurement goes on after the first


class TimeOverError(Exception):
    """No time is left for the rest of a run, or of a part."""


@contextmanager
def time_limit(end: float) -> Iterator[None]:
    """Raise `TimeOverError` in the main thread after a time by `time.monotonic`."""

    def interrupt(*_: object) -> None:
        raise TimeOverError

    before = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, max(end - time.monotonic(), 1e-3), AGAIN_S)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
