# SPDX-License-Identifier: MIT
"""Attempts of chunks that a worker did not live to return, kept in a private folder.

A worker appends each attempt to the file of its chunk, as it would send it to the main process. The
main process removes the file when it has the chunk, and reads what is left if a worker died. Where
nothing can be written, nothing is kept: the next run finds the results of the scans.
"""

import hashlib
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any
from uuid import uuid4

from salsanext_cli.runs.loop.job import Attempt

LENGTH_BYTES = 8  # Size of the number before each attempt, that of its bytes
DIGEST_BYTES = 16  # Size of the digest after that number, by which a part is not read as a whole


@dataclass(frozen=True, slots=True)
class FinishedAttempts:
    """Files of the chunks that workers have begun and not returned."""

    folder: Path | None  # None where no folder could be made

    def file(self, chunk: int) -> Path | None:
        """Return the file of the chunk with a number, None without a folder."""
        return None if self.folder is None else self.folder / str(chunk)

    def forget(self, chunk: int) -> None:
        """Remove the file of a chunk that was returned."""
        if path := self.file(chunk):
            path.unlink(missing_ok=True)

    def __iter__(self) -> Iterator[Attempt[Any]]:
        """Yield the attempts that are left, of each file up to one that is cut off."""
        for path in sorted(self.folder.iterdir()) if self.folder else ():
            for content in _complete_contents(path.read_bytes()):
                yield ForkingPickler.loads(content)


def _complete_contents(written: bytes) -> Iterator[bytes]:
    """Yield the pickled attempts in a file before the first that is cut off."""
    start = 0
    while start + LENGTH_BYTES + DIGEST_BYTES <= len(written):
        begin = start + LENGTH_BYTES + DIGEST_BYTES
        length = int.from_bytes(written[start : start + LENGTH_BYTES], "little")
        digest = written[start + LENGTH_BYTES : begin]
        content = written[begin : begin + length]
        if digest != _digest(content):
            return
        yield content
        start = begin + length


def _digest(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=DIGEST_BYTES).digest()


def append_attempt(path: Path | None, attempt: Attempt[Any]) -> None:
    """Append an attempt to the file of its chunk, if there is one and it can be written."""
    if path is None:
        return
    content = bytes(ForkingPickler.dumps(attempt))
    record = len(content).to_bytes(LENGTH_BYTES, "little") + _digest(content) + content
    # One unbuffered write on a full disk writes a part, which would precede the next attempt.
    with suppress(OSError), path.open("ab", buffering=0) as file:
        start = file.tell()
        if file.write(record) < len(record):
            file.truncate(start)


@contextmanager
def finished_attempts() -> Iterator[FinishedAttempts]:
    """Make a private folder of attempts, which is removed even if this process is killed."""
    from joblib.externals.loky.backend import resource_tracker

    def remove(folder: Path) -> None:
        shutil.rmtree(folder, ignore_errors=True)
        resource_tracker.unregister(str(folder), "folder")

    with ExitStack() as stack:
        made = None
        with suppress(OSError):
            folder = Path(tempfile.gettempdir(), f"salsanext-{uuid4().hex}")
            # It is made last and forgotten last, so that no signal between the steps leaves it.
            resource_tracker.register(str(folder), "folder")
            stack.callback(remove, folder)
            folder.mkdir(mode=0o700)
            made = folder
        yield FinishedAttempts(made)
