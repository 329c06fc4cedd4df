# SPDX-License-Identifier: MIT
"""Time and memory that reading a small file may take."""

from __future__ import annotations

import faulthandler
import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

SECONDS = 2.0
"""Of the processor, for one file of some kilobytes."""
HUNG = 0.5
"""Seconds for each file, on the clock, after which a reader that never returns is ended."""
FREE, PER_BYTE = 16 << 20, 100
"""Bytes that any reader may take, and so many for each byte of the file."""


class TooMuchError(AssertionError):
    """A reader took more time or memory than the file is worth."""


@contextmanager
def ending(files: int) -> Iterator[None]:
    """Show where the body hangs, and end the process, if it never returns."""
    faulthandler.dump_traceback_later(60 + HUNG * files, exit=True)
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()


@contextmanager
def bounded(size: int) -> Iterator[None]:
    """Raise `TooMuchError` if the body takes more than a file of `size` bytes is worth.

    Memory is that of Python and NumPy, touched or only promised.
    """
    tracemalloc.start(1)
    start = time.process_time()
    try:
        yield
        seconds = time.process_time() - start
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    if seconds > SECONDS:
        raise TooMuchError(f"{seconds:.1f} s")
    if peak > FREE + PER_BYTE * size:
        raise TooMuchError(f"{peak / 1e6:.0f} MB for a file of {size} bytes")
