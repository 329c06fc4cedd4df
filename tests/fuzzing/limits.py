# SPDX-License-Identifier: MIT
"""Time and memory that reading a small file may take."""

from __future__ import annotations

import time
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager

from numba.core.event import install_recorder

MAX_CPU_S = 2.0
"""Processor time for one file of some kilobytes."""
MAX_BYTES, MAX_BYTES_PER_BYTE = 16 << 20, 100
"""Memory for any file, and in addition for each byte of it."""


class UnmeasuredError(Exception):
    """A kernel was compiled, which takes seconds, and is done once."""


@contextmanager
def bounded(size: int) -> Iterator[None]:
    """Fail if the body exceeds the time or the memory for a file of `size` bytes.

    Memory is that which Python and NumPy allocate, touched or not. A body that compiles a kernel
    cannot be measured, and raises `UnmeasuredError`.
    """
    tracemalloc.start(1)
    start = time.process_time()
    try:
        with install_recorder("numba:compile") as compilations:
            yield
        seconds = time.process_time() - start
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    if compilations.buffer:
        raise UnmeasuredError
    assert seconds <= MAX_CPU_S
    assert peak <= MAX_BYTES + MAX_BYTES_PER_BYTE * size
