# SPDX-License-Identifier: MIT
"""How the CPU kernels are compiled, cached and shared among threads.

Kernels work on a slice ``start … stop`` and release the interpreter lock, so plain threads run
them side by side. Numba's own parallel loops are not used: its thread pools can neither be
entered from several threads (its default) nor survive a fork (OpenMP), and both happen in data
loaders and worker pools.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

SMALLEST_SLICE = 8192
"""Below this many items a second thread costs more than it saves."""


def compiled(function: Function) -> Function:
    """Compile on first call, strictly in IEEE arithmetic, and cache where a cache can be written.

    Numba caches beside the source or, where that is read-only, in the user's cache folder; with
    neither it refuses to cache, and the kernel is compiled once per process.
    """
    try:
        kernel = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:
        kernel = numba.njit(nogil=True, error_model="numpy")(function)
    return kernel  # type: ignore[no-any-return]


def in_slices(kernel: Callable[..., object], count: int, *arguments: object) -> None:
    """Call ``kernel(start, stop, *arguments)`` for slices that cover ``0 … count``.

    Slices run on up to ``NUMBA_NUM_THREADS`` threads (all cores unless set, as joblib does for its
    workers). A kernel must write to its own slice only, so that the result does not depend on
    their number.
    """
    slices = max(1, min(numba.config.NUMBA_NUM_THREADS, count // SMALLEST_SLICE))
    borders = [count * part // slices for part in range(slices + 1)]
    if slices == 1:
        kernel(0, count, *arguments)
        return
    with ThreadPoolExecutor(slices - 1) as threads:
        others = [
            threads.submit(kernel, start, stop, *arguments)
            for start, stop in zip(borders[1:-1], borders[2:], strict=True)
        ]
        kernel(0, borders[1], *arguments)
    for other in others:
        other.result()
