# SPDX-License-Identifier: MIT
"""Messages that a process logs once, however many scans they concern."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache

NOTICE = 25  # Log level of messages for every user that are not warnings


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning once per process."""
    log.warning("%s", message)


_files_are_known: ContextVar[bool] = ContextVar("files_are_known", default=False)


@contextmanager
def files_known() -> Iterator[None]:
    """Log the assumptions of readers as details only, because an earlier stage has stated them."""
    token = _files_are_known.set(True)
    try:
        yield
    finally:
        _files_are_known.reset(token)


def notice_once(message: str) -> None:
    """Log an assumption of a reader once per process."""
    log_once(message, logging.INFO if _files_are_known.get() else NOTICE)


@cache
def log_once(message: str, level: int) -> None:
    """Log a message at a level once per process."""
    logging.getLogger(__name__).log(level, "%s", message)
