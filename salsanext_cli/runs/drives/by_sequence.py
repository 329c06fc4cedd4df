# SPDX-License-Identifier: MIT
"""One function over the sequences of a run, whose errors belong to one sequence each."""

from collections.abc import Callable, Iterable
from typing import TypeVar

from salsanext_cli.core.errors import SalsanextError

Value = TypeVar("Value")


def by_sequence(
    sequences: Iterable[str], function: Callable[[str], Value], *, stop: bool = False
) -> dict[str, Value | SalsanextError]:
    """Return the value of a function for each sequence, or its error.

    Parameters
    ----------
    sequences : iterable of str
        Names of the sequences.
    function : callable
        Function of a name.
    stop : bool
        Whether to raise the first error.

    Returns
    -------
    dict
        Values and errors by name.

    Raises
    ------
    SalsanextError
        The first error, if all sequences have one or `stop` is given.
    """
    values: dict[str, Value | SalsanextError] = {}
    for name in sequences:
        try:
            values[name] = function(name)
        except SalsanextError as error:
            if stop:
                raise
            values[name] = error
    errors = [value for value in values.values() if isinstance(value, SalsanextError)]
    if errors and len(errors) == len(values):
        raise errors[0]
    return values
