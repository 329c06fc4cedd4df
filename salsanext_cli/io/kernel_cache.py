# SPDX-License-Identifier: MIT
"""Cache of compiled kernels in the cache folder of the user.

This is the only module that uses the private interfaces of numba. Its public cache,
``njit(cache=True)``, fails at every start after a file was truncated or damaged, fails on a full
disk, and writes beside the source. It loads the libraries of the compiler at each start, which
takes half as long again as a start with this cache.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from pickle import PickleError
from typing import Any

import numba
from numba.core.caching import CompileResultCacheImpl as Files
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys
from numba.core.serialize import dumps

from salsanext_cli.core.texts import error_text
from salsanext_cli.io.files.user_cache import (
    cache_folder,
    read_checked,
    warn_of_cache,
    write_checked,
)
from salsanext_cli.version import __version__

CACHE_ERRORS = (
    AttributeError,
    ImportError,
    OSError,
    PickleError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""Errors of folders that cannot be written, and of code of another version of llvmlite."""


def cache_kernel(kernel: Any) -> None:
    """Cache the machine code of a kernel; warn if the cache folder cannot be written.

    Parameters
    ----------
    kernel : numba.core.registry.CPUDispatcher
        Result of `numba.njit` without ``cache=True``.
    """
    settings = vars(numba.config)
    before = settings["CACHE_DIR"]
    settings["CACHE_DIR"] = before or kernel_folder()
    try:
        kernel._cache = KernelCache(kernel.py_func)
    except CACHE_ERRORS:
        folder = settings["CACHE_DIR"] or "a home folder"
        warn_of_cache(f"compiled kernels are not cached: cannot write to {folder}")
    finally:
        # The setting also applies to kernels of other programs in this process.
        settings["CACHE_DIR"] = before


class KernelFiles(Files):
    """Files only in the folder of the setting: that of the package may belong to another user."""

    _locator_classes = Files._locator_classes[:1]


class KernelCache(FunctionCache):
    """Cache of the machine code of a kernel: a file with a checksum for each signature.

    Code that cannot be loaded is compiled again, and code that cannot be stored is used anyway.
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
