# SPDX-License-Identifier: MIT
"""Time that a device needs for calls, by its own clock: a call may return before it ends."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

MS = 1e-3


class DeviceTime:
    """Times of calls on a device, each from the start of its first work to the end of its last.

    On a GPU this is an upper bound of its work: pauses between the pieces of a call count too,
    while the host prepares the next one.

    Parameters
    ----------
    device : str
        ``"cpu"``, ``"cuda"``, ``"cuda:1"`` …; a CPU ends its work before a call returns.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self._marks: list[tuple[Any, Any]] = []  # Before and after each call

    @contextmanager
    def measured(self) -> Iterator[None]:
        """Measure a call, unless it raises."""
        start = self._mark()
        yield
        self._marks.append((start, self._mark()))

    def seconds(self) -> list[float]:
        """Return the time of each measured call in seconds; wait until all have ended."""
        if self.device == "cpu":
            return [end - start for start, end in self._marks]
        for _, end in self._marks:
            end.synchronize()
        return [MS * start.elapsed_time(end) for start, end in self._marks]

    def _mark(self) -> Any:
        """Return the time now, or an event at this place of the work of a GPU."""
        if self.device == "cpu":
            return time.perf_counter()
        import torch

        event = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
        event.record(torch.cuda.current_stream(self.device))
        return event
