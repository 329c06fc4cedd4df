# SPDX-License-Identifier: MIT
"""SIGINT and SIGTERM: they end the process, or raise KeyboardInterrupt in the work of a command.

This is imported before all else, and imports little: signals that come earlier are Python's.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import contextmanager, suppress

TYPE_CHECKING = False  # Of `typing`, which takes its time.
if TYPE_CHECKING:
    from collections.abc import Iterator
    from types import FrameType
    from typing import Any, NoReturn

WORDS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
INTACT = "everything finished so far is intact"
ARRIVED: list[int] = []  # The signal that has arrived during the work, if one has
WAIT_S = 3.0  # Time that a signal waits for an import, or for a context to be entered or left
RETRY_S = 0.02
REPEATED_S = 1.0  # `timeout` sends one signal twice: to a process and to its group
TIMER = getattr(signal, "SIGALRM", None)  # It brings a waiting signal again; without it, none waits


def end_on_signals() -> None:
    """Let signals end this process at once, and quietly, except where `interruptible` says else."""
    for number in filter(_left_to_python, WORDS):
        signal.signal(number, _end)
    if TIMER:
        # The timer may ring after the work, and programs that are started would inherit SIG_IGN.
        signal.signal(TIMER, lambda *_: None)
    sys.unraisablehook = _show_unraisable


def _show_unraisable(unraisable: sys.UnraisableHookArgs) -> None:
    if not ARRIVED:
        sys.__unraisablehook__(unraisable)
    elif unraisable.exc_type is KeyboardInterrupt:
        _come_again()  # It was lost in a destructor, say.


def _left_to_python(number: int) -> bool:
    handlers = (signal.SIG_DFL, signal.default_int_handler, _end)
    return signal.getsignal(number) in handlers


def _end(number: int, _: object) -> NoReturn:
    if not ARRIVED:
        with suppress(OSError):
            os.write(2, f"{WORDS[number]}: {INTACT}\n".encode())
    os._exit(128 + number)  # noqa: TID251


def _come_again() -> None:
    if TIMER:
        signal.setitimer(signal.ITIMER_REAL, RETRY_S)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt` in the body at a signal, and after it whatever has become of that.

    A signal that a program handles itself is left to it; one that comes again ends the process.
    """
    import logging
    import threading

    process, since = os.getpid(), 0.0

    def handle(number: int, frame: FrameType | None) -> None:
        nonlocal since
        now = time.monotonic()
        if os.getpid() != process or (number in WORDS and ARRIVED and now - since > REPEATED_S):
            # A child made by fork ends at once, as it would have without this handler.
            os._exit(128 + number)  # noqa: TID251
        if number in WORDS:
            if ARRIVED:
                return
            ARRIVED.append(number)
            since = now
            if sys.unraisablehook is _show_unraisable:
                logging.disable()  # What libraries say about work that is cut off is noise.
        if TIMER and now - since < WAIT_S and _must_wait(frame):
            _come_again()
        else:
            raise KeyboardInterrupt

    ARRIVED.clear()
    before: dict[int, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in (*filter(_left_to_python, WORDS), *filter(None, [TIMER])):
                before[number] = signal.signal(number, handle)
        yield
    finally:
        if before and TIMER:
            signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before.items():
            signal.signal(number, handler)
        if ARRIVED:
            raise KeyboardInterrupt from None


def _must_wait(frame: FrameType | None) -> bool:
    """Return whether an exception would become another one in a library, or leave disorder."""
    if ARRIVED[0] in signal.pthread_sigmask(signal.SIG_BLOCK, ()):
        # Another thread has taken what the main thread blocks while it starts processes.
        return True
    while frame:
        name, file = frame.f_code.co_name, frame.f_code.co_filename
        if file == "<frozen importlib._bootstrap>":
            return True
        if file == contextmanager.__code__.co_filename and name in ("__enter__", "__exit__"):
            return True
        frame = frame.f_back
    return False
