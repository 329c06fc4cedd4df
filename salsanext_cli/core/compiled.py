# SPDX-License-Identifier: MIT
"""Compilation of the CPU kernels, and loops over slices on several threads.

Kernels release the interpreter lock, so plain threads run them in parallel on slices of arrays.
Numba's thread pools either cannot be entered from several threads (its default) or do not survive a
fork (OpenMP); both happen in worker pools and data loaders.
"""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import pairwise
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from salsanext_cli.core import caches

MAX_THREADS = 256  # Size of the pool, which starts threads only as needed
Function = TypeVar("Function", bound=Callable[..., Any])
Item = TypeVar("Item")
MIN_SLICE_ITEMS = 16384  # Below it, a second thread costs more than it saves


@lru_cache(maxsize=1)
def _pool(_process: int) -> ThreadPoolExecutor:
    """Return the pool of a process; a fork gets a new one."""
    return ThreadPoolExecutor(MAX_THREADS, "salsanext")


def compiled(function: Function) -> Function:
    """Compile on first call, in strict IEEE arithmetic, and cache the machine code if possible."""
    kernel: Any = numba.njit(nogil=True, error_model="numpy")(function)
    caches.used().cache_kernel(kernel)
    return cast(Function, kernel)


def thread_count() -> int:
    """Return the number of threads of this process: NUMBA_NUM_THREADS, by default all cores."""
    return int(vars(numba.config)["NUMBA_NUM_THREADS"])


def argument(array: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return an array as kernels take it, copied only if necessary."""
    # Numba compiles again for arrays that are read-only, unaligned or not contiguous.
    return np.require(array, dtype, ["C_CONTIGUOUS", "ALIGNED", "WRITEABLE"])


def parallel_for(work: Callable[[Item], object], items: Sequence[Item]) -> None:
    """Call a function for all items on up to `thread_count` threads; results must not overlap."""
    waiting = iter(items)

    # `next` of an iterator over a sequence is one step of the interpreter: no lock is needed.
    def pull() -> None:
        for item in waiting:
            work(item)

    threads = min(thread_count(), len(items))
    helpers = [_pool(os.getpid()).submit(pull) for _ in range(threads - 1)]
    try:
        pull()
    finally:
        # A helper can only be cancelled as long as no thread has begun with it.
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def parallel_for_slices(work: Callable[[slice], object], count: int, cost: int = 1) -> None:
    """Call a function for slices of a range, one per thread of `parallel_for`.

    Parameters
    ----------
    work : callable
        Function of a slice. The result must not depend on the number of slices.
    count : int
        End of the range ``0 … count`` that the slices cover.
    cost : int
        Time per item, relative to that of a point's projection; costly items need fewer for a
        thread.
    """
    threads = max(1, min(thread_count(), count * cost // MIN_SLICE_ITEMS))
    borders = [count * number // threads for number in range(threads + 1)]
    parallel_for(work, [slice(start, stop) for start, stop in pairwise(borders)])
