# SPDX-License-Identifier: MIT
"""SIGINT and SIGTERM: the first signal interrupts a command, the second ends the process."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

WORDS: dict[int, str] = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}
NO_HALF_FILES = "no file is incomplete"
ARRIVED: list[int] = []  # Number of the first signal, if any
BUSY: list[bool] = []  # Not empty while a command runs
STATEMENTS: list[Callable[[], str]] = []  # The last one returns what is finished, in words
REPEATED_S = 1.0  # `timeout` sends one signal twice: to a process and to its group


def handle_signals() -> None:
    """Raise `KeyboardInterrupt` in a command at the first signal; end the process at the second.

    Outside a command the first signal ends the process. Signals that are ignored or handled already
    stay as they are.
    """
    process = os.getpid()
    since = 0.0

    def handle(number: int, _: object) -> None:
        nonlocal since
        now = time.monotonic()
        if os.getpid() != process or (ARRIVED and now - since > REPEATED_S):
            # A forked child ends at once, as without this handler.
            os._exit(128 + number)  # noqa: TID251
        if not ARRIVED:
            ARRIVED.append(number)
            since = now
            if not BUSY:
                with suppress(OSError):
                    os.write(2, f"{end_line()}\n".encode())
                os._exit(128 + number)  # noqa: TID251
            raise KeyboardInterrupt

    for number in WORDS:
        if signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler):
            signal.signal(number, handle)
    _hide_dropped_interruptions()


def _hide_dropped_interruptions() -> None:
    """Print no traceback if Python drops the interruption of a callback, such as in an import."""
    show = sys.unraisablehook

    def show_others(dropped: sys.UnraisableHookArgs) -> None:
        if not (ARRIVED and dropped.exc_type is KeyboardInterrupt):
            show(dropped)

    sys.unraisablehook = show_others


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt` after a body with a signal, even if a library has caught it."""
    BUSY.append(True)
    STATEMENTS.clear()
    try:
        yield
    finally:
        BUSY.clear()
        if ARRIVED:
            raise KeyboardInterrupt from None


@contextmanager
def on_interruption(state: Callable[[], str]) -> Iterator[None]:
    """If the body is interrupted, end with a line that states what is finished.

    `state`: called after the interruption; returns what is finished, in words.
    """
    STATEMENTS.append(state)
    yield
    # After an exception it stays, since `end_line` needs it.
    STATEMENTS.remove(state)


def require_uninterrupted() -> None:
    """Raise `KeyboardInterrupt` if a signal has arrived: Python drops it in some callbacks."""
    if ARRIVED:
        raise KeyboardInterrupt


def keep_exit_status() -> None:
    """Let ``python -m`` end with its exit status although a signal arrived during `exec`.

    Libraries create classes by `exec`. If it ends with `KeyboardInterrupt`, Python notes that and
    ends itself with SIGINT, even if the error was caught. The next `exec` removes the note.
    """
    exec("")  # noqa: S102 - the text is empty


def signal_number() -> int:
    """Return the number of the signal that arrived, else that of SIGINT."""
    return ARRIVED[0] if ARRIVED else signal.SIGINT


def end_line() -> str:
    """Return the line to print after an interruption, which states what is finished."""
    finished = STATEMENTS[-1]() if STATEMENTS else NO_HALF_FILES
    return f"{WORDS[signal_number()]}: {finished}"
