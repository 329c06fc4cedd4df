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
HUNG = 60.0
"""After so long a reader that never returns is shown and ended."""
FREE, PER_BYTE = 16 << 20, 100
"""Bytes that any reader may take, and so many for each byte of the file."""


class TooMuchError(AssertionError):
    """A reader took more time or memory than the file is worth."""


@contextmanager
def bounded(size: int) -> Iterator[None]:
    """Raise `TooMuchError` if the body takes more than a file of `size` bytes is worth.

    Memory is that of Python and NumPy, touched or only promised.
    """
    faulthandler.dump_traceback_later(HUNG, exit=True)
    tracemalloc.start(1)
    start = time.process_time()
    try:
        yield
        seconds = time.process_time() - start
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        faulthandler.cancel_dump_traceback_later()
    if seconds > SECONDS:
        raise TooMuchError(f"{seconds:.1f} s")
    if peak > FREE + PER_BYTE * size:
        raise TooMuchError(f"{peak / 1e6:.0f} MB for a file of {size} bytes")
