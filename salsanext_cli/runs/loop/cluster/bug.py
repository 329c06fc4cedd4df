# SPDX-License-Identifier: MIT
"""Exceptions of workers on their way to the main process."""

import pickle
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Bug:
    """Exception of a worker that no user can correct."""

    error: BaseException
    trace: str

    @classmethod
    def packed(cls, error: BaseException, trace: str) -> bytes:
        """Return a pickled bug; an exception that cannot be pickled becomes its text."""
        try:
            content = pickle.dumps(cls(error=error, trace=trace))
            pickle.loads(content)  # noqa: S301 - written above
        except Exception:  # noqa: BLE001 - whatever the exception contains
            return pickle.dumps(cls(error=RuntimeError(str(error)), trace=trace))
        return content

    def noted(self) -> BaseException:
        """Return the exception with the traceback of the worker as a note."""
        self.error.add_note(self.trace)
        return self.error
