# SPDX-License-Identifier: MIT
"""Files in the cache folder of the user: reproducible, written atomically, with a checksum."""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.texts import error_text
from salsanext_cli.io.files.atomic import sweep_stale, writing
from salsanext_cli.version import __version__

CHECKSUM_BYTES = 32
MAX_FOLDER_BYTES = 2 << 30

log = logging.getLogger(__name__)
_warned: set[str] = set()  # Cache folders that this process has warned of


def cache_folder() -> str:
    """Return the cache folder, such as ``$XDG_CACHE_HOME/salsanext``; empty without a home."""
    try:
        home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    except RuntimeError:
        return ""
    return str(Path(home) / "salsanext")


def cached(name: str, make: Callable[[], bytes]) -> bytes:
    """Return the content of a cached file, which is created if it is missing or damaged."""
    folder = cache_folder()
    content = read_checked(Path(folder, name)) if folder else None
    return store(name, make()) if content is None else content


def check_once(name: str, check: Callable[[], object]) -> None:
    """Call a check that raises an error, unless it passed under that name in this version."""

    def passed() -> bytes:
        check()
        return b"checked"

    cached(f"weights/{name}-{__version__}.checked", passed)


def store(name: str, content: bytes) -> bytes:
    """Write a cached file, replacing an older one, and return its content."""
    folder = cache_folder()
    if folder:
        write_checked(Path(folder, name), content)
    return content


def write_checked(path: Path, content: bytes, most_bytes: int = MAX_FOLDER_BYTES) -> None:
    """Write a file with a checksum, and remove the oldest of its folder above a size in bytes.

    If that is impossible, a warning is logged once.
    """
    try:
        with writing(path) as file:
            file.write(content + hashlib.sha256(content).digest())
        sweep_stale(path.parent)
        _remove_oldest(path, most_bytes)
    except (OutputError, OSError) as error:
        warn_of_cache(f"{error_text(error)}: continuing without it")


def read_checked(path: Path) -> bytes | None:
    """Read a file with a checksum; None if it is missing, or damaged, with a warning."""
    try:
        with path.open("rb") as file:
            data = file.read(max(0, os.fstat(file.fileno()).st_size - CHECKSUM_BYTES))
            checksum = file.read()
    except FileNotFoundError:
        return None
    except OSError as error:
        warn_of_cache(f"{error_text(error)}: continuing without it")
        return None
    if hashlib.sha256(data).digest() == checksum:
        with suppress(OSError):  # a folder that can only be read
            path.touch()
        return data
    warn_of_cache(f"{path} is damaged: created again")
    return None


def _remove_oldest(newest: Path, most_bytes: int) -> None:
    """Remove the least recently used files of a folder above a size in bytes."""
    with suppress(OSError):
        files = [(file.stat(), file) for file in newest.parent.glob(f"*{newest.suffix}")]
        total = sum(status.st_size for status, _ in files)
        for status, file in sorted(files, key=lambda pair: pair[0].st_mtime):
            if total <= most_bytes or file == newest:
                break
            file.unlink(missing_ok=True)
            total -= status.st_size


def warn_of_cache(problem: str) -> None:
    """Warn of the first problem with the cache folder in this process."""
    folder = cache_folder()
    if folder not in _warned:
        _warned.add(folder)
        log.warning("cache: %s", problem)
