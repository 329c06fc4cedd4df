# SPDX-License-Identifier: MIT
"""Bound of a test that could wait for other processes without an end."""

import faulthandler
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

GRACE_S = 60.0  # For a test to end after its limit, before its process is ended


class TimeLimitError(BaseException):
    """Limit that a body has exceeded; no handler of other errors catches it."""


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `TimeLimitError` in a body that takes longer, and print the stacks of all threads.

    A body in which no Python code runs cannot raise it; its process ends a minute later.
    """
    if not hasattr(signal, "setitimer"):
        yield
        return

    def fail(*_: object) -> None:
        faulthandler.dump_traceback(sys.__stderr__)
        raise TimeLimitError(f"more than {seconds} s")

    before = signal.signal(signal.SIGALRM, fail)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    faulthandler.dump_traceback_later(seconds + GRACE_S, exit=True, file=sys.__stderr__)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
