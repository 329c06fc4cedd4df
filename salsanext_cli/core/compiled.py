# SPDX-License-Identifier: MIT
"""Compilation of the CPU kernels, their cache, and loops over slices on several threads.

Kernels release the interpreter lock, so plain threads run them in parallel on slices of arrays.
Numba's thread pools either cannot be entered from several threads (its default) or do not survive a
fork (OpenMP); both happen in worker pools and data loaders.
"""

import hashlib
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from pickle import PickleError
from typing import Any, TypeVar, cast

import numba
import numpy as np
import numpy.typing as npt
from numba.core.caching import CompileResultCacheImpl as Files
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from salsanext_cli.core.errors import error_text
from salsanext_cli.io.files.user_cache import (
    cache_folder,
    read_checked,
    warn_of_cache,
    write_checked,
)
from salsanext_cli.version import __version__

MAX_THREADS = 256  # Size of the pool, which starts threads only as needed
Function = TypeVar("Function", bound=Callable[..., Any])
Item = TypeVar("Item")
CACHE_ERRORS = (
    *(AttributeError, ImportError, OSError, PickleError, RuntimeError, TypeError, ValueError),
)
"""Errors of folders that cannot be written, and of code of another version of llvmlite."""
MIN_SLICE_ITEMS = 16384  # Below it, a second thread costs more than it saves


@lru_cache(maxsize=1)
def _pool(_process: int) -> ThreadPoolExecutor:
    """Return the pool of a process; a fork gets a new one."""
    return ThreadPoolExecutor(MAX_THREADS, "salsanext")


def compiled(function: Function) -> Function:
    """Compile on first call, in strict IEEE arithmetic, and cache the machine code if possible."""
    kernel: Any = numba.njit(nogil=True, error_model="numpy")(function)
    settings = vars(numba.config)
    before = settings["CACHE_DIR"]
    settings["CACHE_DIR"] = before or kernel_folder()
    try:
        kernel._cache = KernelCache(function)
    except CACHE_ERRORS:
        folder = settings["CACHE_DIR"] or "a home folder"
        warn_of_cache(f"compiled kernels are not cached: cannot write to {folder}")
    finally:
        # The setting also applies to kernels of other programs in this process.
        settings["CACHE_DIR"] = before
    return cast(Function, kernel)


class KernelFiles(Files):
    """Files only in the folder of the setting: that of the package may belong to another user."""

    _locator_classes = Files._locator_classes[:1]


class KernelCache(FunctionCache):
    """Cache of the machine code of a kernel: a file with a checksum for each signature.

    Numba's cache fails at a truncated file and on a full disk, and loads libraries for half a
    second at each start. This one compiles again instead.
    """

    _impl_class = KernelFiles

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return the compiled kernel of a signature; None without a usable one."""
        # Compiled code needs only numba's memory; a compilation loads its libraries itself.
        rtsys.initialize(target_context)
        try:
            file = self._file(sig, target_context.codegen())
            if read_checked(file) is None:
                return None
            return self._impl.rebuild(target_context, self._cache_file._load_data(file.name))
        except CACHE_ERRORS as error:
            warn_of_cache(f"compiled kernels: {error_text(error)}")
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Write the compiled kernel of a signature, if possible."""
        try:
            if self._impl.check_cachable(data):
                write_checked(self._file(sig, data.codegen), dumps(self._impl.reduce(data)))
        except CACHE_ERRORS as error:
            warn_of_cache(f"compiled kernels: {error_text(error)}")

    def _file(self, sig: Any, codegen: Any) -> Path:
        """Return the file of a signature; its name depends on versions, source and processor."""
        # The version of this package covers kernels in other files that a kernel calls.
        source = self._impl.locator.get_source_stamp(), self._index_key(sig, codegen)
        digest = hashlib.sha256(repr((numba.__version__, __version__, source)).encode())
        return Path(self.cache_path) / f"{self._impl.filename_base}.{digest.hexdigest()[:16]}.nbc"


def kernel_folder() -> str:
    """Return the folder of compiled kernels in the cache; empty without a cache."""
    return cache_folder() and str(Path(cache_folder(), "kernels"))


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
        begun = [helper for helper in helpers if not helper.cancel()]
        wait(begun)
    for helper in begun:
        helper.result()


def parallel_for_slices(work: Callable[[slice], object], count: int, cost: int = 1) -> None:
    """Call `work` for slices that cover ``0 … count``, one per thread of `parallel_for`.

    The result must not depend on their number. Items of a higher `cost` need fewer for a thread.
    """
    threads = max(1, min(thread_count(), count * cost // MIN_SLICE_ITEMS))
    borders = [count * part // threads for part in range(threads + 1)]
    parallel_for(work, [slice(start, stop) for start, stop in pairwise(borders)])
