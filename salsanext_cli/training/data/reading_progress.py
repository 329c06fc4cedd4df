# SPDX-License-Identifier: MIT
"""Lines about the progress of reading scans, which a training begins with."""

import logging
import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.texts import counted

NOTE_INTERVAL_S = 30.0  # Between two lines about the number of scans that have been read
Result = TypeVar("Result")

log = logging.getLogger(__name__)


def with_progress(results: Iterable[Result], total: int) -> Iterator[Result]:
    """Yield the results of scans, and log from time to time how many there are of a total."""
    begun = time.monotonic()
    noted = begun
    for done, result in enumerate(results, 1):
        yield result
        now = time.monotonic()
        if now - noted > NOTE_INTERVAL_S:
            noted = now
            left = (total - done) / done * (now - begun)
            text = "%s of %s read, about %s left"
            log.log(NOTICE, text, f"{done:,}", counted(total, "scan"), f"{left:,.0f} s")
