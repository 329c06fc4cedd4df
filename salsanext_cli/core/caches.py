# SPDX-License-Identifier: MIT
"""Caches of what takes long to make, which the package hands in; without them, it is made again.

The package imports this module at its own import, so that it imports nothing itself.
"""

from __future__ import annotations

TYPE_CHECKING = False  # Importing it from `typing` takes time.
if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path
    from typing import Any


class Caches:
    """Caches of compiled kernels and graphs; these store nothing."""

    def cache_kernel(self, kernel: Any) -> None:
        """Load the machine code of a kernel of numba from a cache, and store new code in it."""

    def cached(self, name: str, make: Callable[[], bytes]) -> bytes:
        """Return what is stored under a name; what is missing or damaged is made and stored."""
        return make()

    def store(self, name: str, content: bytes) -> bytes:
        """Store content under a name, in place of an older one, and return it."""
        return content

    def temporary_folder(self) -> AbstractContextManager[Path]:
        """Return a folder that is removed after the body."""
        raise NotImplementedError


_used = Caches()


def use(caches: Caches) -> None:
    """Use these caches in this process from now on."""
    global _used
    _used = caches


def used() -> Caches:
    """Return the caches of this process."""
    return _used
