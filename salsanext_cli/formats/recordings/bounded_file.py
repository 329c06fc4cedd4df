# SPDX-License-Identifier: MIT
"""File that never gives more than it holds, whatever size a damaged header claims."""

import io
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import cast

MAX_LINE = 64
"""Bytes of a line; the only one is the first of a ROS 1 bag, of 13."""


class BoundedFile(io.BufferedReader):
    """File of which a read allocates no more than is left; after its end, other bytes follow.

    `path`: the file; `end`: number of its bytes that count; `tail`: read after them.
    """

    def __init__(self, path: Path, end: int | None = None, tail: bytes = b"") -> None:
        self.size = (path.stat().st_size if end is None else end) + len(tail)
        super().__init__(cast(io.RawIOBase, _Tailed(path, self.size - len(tail), tail)))

    def read(self, size: int | None = -1, /) -> bytes:
        """Read up to `size` bytes, or all that are left."""
        left = max(self.size - self.tell(), 0)
        return super().read(left if size is None or size < 0 else min(size, left))

    def readline(self, size: int | None = -1, /) -> bytes:
        """Read a line of at most `MAX_LINE` bytes."""
        return super().readline(MAX_LINE)


class _Tailed(io.RawIOBase):
    def __init__(self, path: Path, end: int, tail: bytes) -> None:
        self._file, self._end, self._tail, self._at = io.FileIO(path), end, tail, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        starts = (0, self._at, self._end + len(self._tail))
        self._at = max(starts[whence] + offset, 0)
        return self._at

    def readinto(self, buffer: memoryview, /) -> int:  # type: ignore[override]
        if self._at < self._end:
            self._file.seek(self._at)
            wanted = memoryview(buffer)[: self._end - self._at]
            count = self._file.readinto(wanted) or 0
        else:
            rest = self._tail[self._at - self._end :][: len(buffer)]
            count = len(rest)
            buffer[:count] = rest
        self._at += count
        return count

    def close(self) -> None:
        self._file.close()
        super().close()


@dataclass(frozen=True, slots=True)
class BoundedPath:
    """Stand-in for a path, for libraries that open their files themselves."""

    path: Path
    end: int | None = None
    tail: bytes = b""

    def __str__(self) -> str:
        return str(self.path)

    def exists(self) -> bool:
        """Say whether the file exists."""
        return self.path.exists()

    def stat(self) -> SimpleNamespace:
        """Return the size, as the status of a file has it."""
        with self.open("rb") as file:
            return SimpleNamespace(st_size=file.size)

    def open(self, mode: str) -> BoundedFile:
        """Open the file; `mode` is rb."""
        return BoundedFile(self.path, self.end, self.tail)
