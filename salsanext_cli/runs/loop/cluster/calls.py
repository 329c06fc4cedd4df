# SPDX-License-Identifier: MIT
"""Calls that the main thread of the driver makes, which other threads put into a queue."""

from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any

Calls = SimpleQueue[Callable[[], None]]


def call_after(
    calls: Calls, future: "Future[Any]", function: Callable[["Future[Any]"], None]
) -> None:
    """Let the main thread call a function with a future when that is done."""
    future.add_done_callback(lambda done: calls.put(partial(function, done)))
