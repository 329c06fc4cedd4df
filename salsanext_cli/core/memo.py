# SPDX-License-Identifier: MIT
"""Memory of the last results of a slow function, by a digest of what they were computed from."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

Result = TypeVar("Result")


class Memo(Generic[Result]):
    """Last results of a function, which several threads may use.

    Parameters
    ----------
    most : int
        Number of results that are remembered.
    """

    def __init__(self, most: int) -> None:
        self.most = most
        self._results: OrderedDict[Hashable, Result] = OrderedDict()
        self._lock = threading.Lock()

    def result(self, key: Hashable, compute: Callable[[], Result]) -> Result:
        """Return the result for a key, which is computed unless it is remembered."""
        with self._lock:
            if key in self._results:
                self._results.move_to_end(key)
                return self._results[key]
        computed = compute()
        with self._lock:
            self._results[key] = computed
            while len(self._results) > self.most:
                self._results.popitem(last=False)
        return computed
