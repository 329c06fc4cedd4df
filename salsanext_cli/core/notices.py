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


_reader_level: ContextVar[int] = ContextVar("reader_level", default=NOTICE)


@contextmanager
def demote_reader_notices() -> Iterator[None]:
    """Log the assumptions of readers as details only, because an earlier stage has stated them."""
    token = _reader_level.set(logging.INFO)
    try:
        yield
    finally:
        _reader_level.reset(token)


def notice_once(message: str) -> None:
    """Log an assumption of a reader once per process; other notices call `log_once`."""
    log_once(message, _reader_level.get())


@cache
def log_once(message: str, level: int) -> None:
    """Log a message at a level once per process."""
    logging.getLogger(__name__).log(level, "%s", message)


_result_level: ContextVar[int] = ContextVar("result_level", default=NOTICE)


@contextmanager
def demote_result_notices() -> Iterator[None]:
    """Log what concerns only labels as details, because the body computes none."""
    token = _result_level.set(logging.INFO)
    try:
        yield
    finally:
        _result_level.reset(token)


def result_level() -> int:
    """Return the level of messages that concern only labels."""
    return _result_level.get()
