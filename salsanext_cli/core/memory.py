# SPDX-License-Identifier: MIT
"""Whether an error means that memory ran out."""

from salsanext_cli.core.errors import SalsanextError

NO_MEMORY = (
    "allocate memory",
    "bad_alloc",
    "bad allocation",
    "can't alloc",
    "failed to map segment",
    "can't start new thread",
    "cuda out of memory",
    "cuda error: out of memory",
    "cublas_status_alloc_failed",
    "cudnn_status_alloc_failed",
    "cublas_status_not_initialized",
)
"""Words of the system, Python, torch, CUDA and OpenVINO when memory runs out."""


def out_of_memory(error: BaseException | None) -> bool:
    """Return whether an unexplained error, or one of its causes, means that memory ran out."""
    while error is not None and not isinstance(error, SalsanextError):
        text = str(error).lower()
        is_named = isinstance(error, MemoryError) or type(error).__name__ == "OutOfMemoryError"
        if is_named or any(words in text for words in NO_MEMORY):
            return True
        error = error.__cause__ or error.__context__
    return False
