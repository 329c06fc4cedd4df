# SPDX-License-Identifier: MIT
"""Observation of the calls of a function, which does what it did."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import signature
from types import FunctionType
from typing import Any


def stand_in(*arguments: Any, **options: Any) -> Any:
    """Call what takes the place of the constant in a copy of this code."""
    return "NOTE".__call__(*arguments, **options)


@contextmanager
def calls_of(function: Callable[..., Any]) -> Iterator[list[dict[str, Any]]]:
    """Collect the arguments of every call of a Python function, by name, in all threads.

    The function stays the same object, wherever it is known, but has other code meanwhile: a
    profiler would be called for each call of any function.
    """
    assert isinstance(function, FunctionType)
    calls: list[dict[str, Any]] = []
    code = function.__code__
    closure, defaults = function.__closure__, function.__defaults__
    original = FunctionType(code, function.__globals__, function.__name__, defaults, closure)
    original.__kwdefaults__ = function.__kwdefaults__
    parameters = signature(original)
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]

    def note(*arguments: Any, **options: Any) -> Any:
        bound = parameters.bind(*arguments, **options)
        bound.apply_defaults()
        calls.append({name: bound.arguments[name] for name in names})
        return original(*arguments, **options)

    constants = tuple(note if value == "NOTE" else value for value in stand_in.__code__.co_consts)
    function.__code__ = stand_in.__code__.replace(
        co_consts=constants, co_freevars=code.co_freevars, co_name=code.co_name
    )
    try:
        yield calls
    finally:
        function.__code__ = code
