# SPDX-License-Identifier: MIT
"""Caches in the cache folder of the user; each is imported when it is first used."""

from __future__ import annotations

from salsanext_cli.core.caches import Caches

TYPE_CHECKING = False  # Importing it from `typing` takes time.
if TYPE_CHECKING:
    from collections.abc import Callable
    from contextlib import AbstractContextManager
    from pathlib import Path
    from typing import Any


class UserCaches(Caches):
    """Caches in the cache folder of the user."""

    def cache_kernel(self, kernel: Any) -> None:
        """Load the machine code of a kernel from the cache folder, and store new code in it."""
        from salsanext_cli.io.kernel_cache import cache_kernel

        cache_kernel(kernel)

    def cached(self, name: str, make: Callable[[], bytes]) -> bytes:
        """Return a cached file, which is made if it is missing or damaged."""
        from salsanext_cli.io.files.user_cache import cached

        return cached(name, make)

    def store(self, name: str, content: bytes) -> bytes:
        """Write a cached file, in place of an older one, and return its content."""
        from salsanext_cli.io.files.user_cache import store

        return store(name, content)

    def temporary_folder(self) -> AbstractContextManager[Path]:
        """Create a folder that another process removes, if this one is killed."""
        from salsanext_cli.io.files.locks import temporary_folder

        return temporary_folder()
