# SPDX-License-Identifier: MIT
"""Interruptions that libraries turn into other errors."""

from __future__ import annotations


def require_no_interruption(error: BaseException) -> None:
    """Raise `KeyboardInterrupt` if an error is the consequence of one.

    Modules in C++ turn an interruption of their import into an `ImportError`.
    """
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:  # An error may be a cause of its cause.
        if isinstance(cause, KeyboardInterrupt):
            raise KeyboardInterrupt from error
        seen.add(id(cause))
        cause = cause.__cause__ or cause.__context__
