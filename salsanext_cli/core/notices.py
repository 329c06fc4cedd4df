# SPDX-License-Identifier: MIT
"""Messages that a process logs once, however many scans they concern."""

import logging
from functools import cache

NOTICE = 25  # Log level of messages for every user that are not warnings


@cache
def warn_once(log: logging.Logger, message: str) -> None:
    """Log a warning once per process."""
    log.warning("%s", message)


@cache
def notice_once(message: str, level: int = NOTICE) -> None:
    """Log an assumption of a reader once per process."""
    logging.getLogger(__name__).log(level, "%s", message)
