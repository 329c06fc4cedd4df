# SPDX-License-Identifier: MIT
"""Signals that wait while threads and processes are started, which they do not reach."""

import signal
import threading
from collections.abc import Generator, Sequence
from contextlib import ExitStack, contextmanager
from types import FrameType


@contextmanager
def signals_blocked(*signals: signal.Signals) -> Generator[None, None, None]:
    """Start threads and processes that signals do not reach, because this thread ends them.

    A signal that arrives meanwhile takes effect at the end of the body. The trackers of resources
    must run before, because starting these unblocks the signals.
    """
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
    try:
        with _handlers_waiting(signals):
            yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _handlers_waiting(signals: Sequence[signal.Signals]) -> Generator[None, None, None]:
    """Call no handler of signals in the body, and block the first that arrived at its end.

    Threads of libraries do not block signals. If one receives a signal, Python calls the handler
    in the main thread, whatever that blocks.
    """
    arrived: list[int] = []

    def note(number: int, _: FrameType | None) -> None:
        arrived.append(number)

    def repeat() -> None:
        for number in arrived[:1]:
            signal.raise_signal(number)

    with ExitStack() as ending:
        if threading.current_thread() is threading.main_thread():
            ending.callback(repeat)
            for number in signals:
                handler = signal.getsignal(number)
                if callable(handler):
                    ending.callback(signal.signal, number, handler)
                    signal.signal(number, note)
        yield
