# SPDX-License-Identifier: MIT
"""How the CPU kernels are compiled, cached and shared among threads.

Kernels release the interpreter lock and work on slices of arrays, so plain threads run them side
by side. Numba's own parallel loops are not used: its thread pools can either not be entered from
several threads (its default) or not survive a fork (OpenMP), and both happen in worker pools and
data loaders.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt

from salsanext_cli.thread_pool import run_on_threads

Function = TypeVar("Function", bound=Callable[..., Any])

SMALLEST_SLICE = 16384
"""Items below which a second thread costs more than it saves."""


def compiled(function: Function) -> Function:
    """Compile on first call, strictly in IEEE arithmetic, and cache where a cache can be written.

    That is the folder NUMBA_CACHE_DIR, by default the user's cache folder, which all processes
    share; else beside the source. With neither numba refuses to cache; then the kernel is compiled
    once per process.
    """
    settings = vars(numba.config)
    before = settings["CACHE_DIR"]
    settings["CACHE_DIR"] = before or cache_folder()
    try:
        kernel = numba.njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:
        kernel = numba.njit(nogil=True, error_model="numpy")(function)
    finally:
        # What other programs compile in this process is not ours to place.
        settings["CACHE_DIR"] = before
    return cast(Function, kernel)


def cache_folder() -> str:
    """Return where compiled kernels are kept: ``$XDG_CACHE_HOME/salsanext`` or the like.

    It is empty, for nowhere, if the user has no home.
    """
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        return ""
    return str(Path(home) / "salsanext" / "kernels")


def argument(array: npt.NDArray[Any], dtype: npt.DTypeLike) -> npt.NDArray[Any]:
    """Return the array as kernels take it, copied only if it must be.

    Numba compiles anew for arrays that are read-only, unaligned or not contiguous.
    """
    return np.require(array, dtype, ["C_CONTIGUOUS", "ALIGNED", "WRITEABLE"])


def parallel_for_slices(work: Callable[[slice], object], count: int) -> None:
    """Call ``work(part)`` for slices that cover ``0 … count``, on several threads.

    There are up to ``NUMBA_NUM_THREADS`` of them: all cores, unless that variable is set, as joblib
    does for its workers. Each call must write to its own part only, so that the result does not
    depend on their number.
    """
    cores: int = vars(numba.config)["NUMBA_NUM_THREADS"]
    threads = max(1, min(cores, count // SMALLEST_SLICE))
    borders = [count * part // threads for part in range(threads + 1)]
    slices = iter([slice(start, stop) for start, stop in pairwise(borders)])

    # `next` of an iterator over a list is one step of the interpreter: no lock is needed.
    def pull() -> None:
        for part in slices:
            work(part)

    run_on_threads(pull, threads)
