# SPDX-License-Identifier: MIT
"""Whether an error means that memory ran out, and whether it was that of a GPU."""

from collections.abc import Iterable, Iterator

from salsanext_cli.core.engines.registry import LIBRARIES
from salsanext_cli.core.errors import SalsanextError

NO_MEMORY = (
    "allocate memory",
    "bad_alloc",
    "bad allocation",
    "failed to map segment",
    "can't start new thread",
)
"""Words of the system, of C++ and of Python when memory runs out; libraries add theirs."""

OUT_OF_GPU_MEMORY = "OutOfMemoryError"  # Class of torch, which need not be imported


def out_of_memory(error: BaseException | None) -> bool:
    """Return whether an unexplained error, or one of its causes, means that memory ran out."""
    return any(_means_memory(cause) for cause in _unexplained(error))


def out_of_gpu_memory(error: BaseException | None) -> bool:
    """Return whether the memory that ran out by an unexplained error is that of a GPU.

    The cause of an error decides. An error without a cause decides for itself, also if it was
    raised while another error was handled.
    """
    for cause in _unexplained(error):
        if _means_gpu_memory(cause):
            return True
        if _means_memory(cause) and cause.__cause__ is None:
            return False
    return False


def _unexplained(error: BaseException | None) -> Iterator[BaseException]:
    """Yield an error and its causes, the last one first, up to a `SalsanextError`."""
    while error is not None and not isinstance(error, SalsanextError):
        yield error
        error = error.__cause__ or error.__context__


def _means_memory(error: BaseException) -> bool:
    if isinstance(error, MemoryError) or _means_gpu_memory(error):
        return True
    words = [*NO_MEMORY]
    for library in LIBRARIES.values():
        words += library.memory_errors
    return _contains_any(error, words)


def _means_gpu_memory(error: BaseException) -> bool:
    words: list[str] = []
    for library in LIBRARIES.values():
        words += library.gpu_memory_errors
    return type(error).__name__ == OUT_OF_GPU_MEMORY or _contains_any(error, words)


def _contains_any(error: BaseException, words: Iterable[str]) -> bool:
    """Return whether the text of an error contains some words in lower case."""
    text = str(error).lower()
    return any(word in text for word in words)
