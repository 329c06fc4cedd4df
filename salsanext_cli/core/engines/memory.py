# SPDX-License-Identifier: MIT
"""Whether an error means that memory ran out."""

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
    library_words = [words for library in LIBRARIES.values() for words in library.memory_errors]
    while error is not None and not isinstance(error, SalsanextError):
        text = str(error).lower()
        is_named = isinstance(error, MemoryError) or type(error).__name__ == OUT_OF_GPU_MEMORY
        if is_named or any(words in text for words in (*NO_MEMORY, *library_words)):
            return True
        error = error.__cause__ or error.__context__
    return False


def out_of_gpu_memory(error: BaseException | None) -> bool:
    """Return whether an unexplained error, or one of its causes, is of the memory of a GPU."""
    while error is not None:
        if type(error).__name__ == OUT_OF_GPU_MEMORY:
            return True
        error = error.__cause__ or error.__context__
    return False
