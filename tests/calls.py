# SPDX-License-Identifier: MIT
"""Observation of the calls of a function, which stays as it is."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any


@contextmanager
def calls_of(function: Callable[..., Any]) -> Iterator[list[dict[str, Any]]]:
    """Collect the arguments of every call of a Python function, by name, in all new threads."""
    calls: list[dict[str, Any]] = []
    code = function.__code__  # type: ignore[attr-defined]
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]

    def note(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code is code:
            calls.append({name: frame.f_locals[name] for name in arguments})

    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield calls
    finally:
        sys.setprofile(None)
        threading.setprofile(None)
