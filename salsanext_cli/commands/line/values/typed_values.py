# SPDX-License-Identifier: MIT
"""Values from the text that was typed: a sensor, a share, a position."""

from math import isfinite
from typing import TYPE_CHECKING, overload

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import did_you_mean

if TYPE_CHECKING:
    from salsanext_cli.core.records import Origin
    from salsanext_cli.core.sensors.sensor import Sensor


def typed_sensor(name: str | None) -> "Sensor | None":
    """Look up a sensor; return None for no name."""
    from salsanext_cli.io.sensors import sensor as find

    return None if name is None else find(name)


@overload
def typed_share(option: str, text: str, word: str = "") -> float: ...
@overload
def typed_share(option: str, text: str | None, word: str = "") -> float | None: ...
def typed_share(option: str, text: str | None, word: str = "") -> float | None:
    """Return a share of at most 1 that is typed as ``5%`` or ``0.05``; stages check its range.

    `word`: what the option takes besides a share, for the error.
    """
    if text is None:
        return None
    number = text.removesuffix("%")
    try:
        value = float(number)
    except ValueError:
        problem = f"{text!r} is not a share"
        expected = "5% or 0.05, for example"
        hint = ""
        if word:
            problem = f"{problem} and not {word}"
            expected = f"a share such as 5% or 0.05, or {word}"
            hint = did_you_mean(text, [word])
        raise UsageError(option, problem, expected, hint) from None
    fraction = value / 100 if text.endswith("%") else value
    if fraction > 1:
        hint = f"did you mean {number}%?" if 1 < value <= 100 else ""
        problem = f"{text} is {100 * fraction:g} %"
        raise UsageError(option, problem, "a share of at most 100%", hint)
    return fraction


def typed_position(option: str, text: str | None) -> "Origin | None":
    """Return a position in metres, which is typed as ``500100,5400020,312``; None for no text."""
    if text is None:
        return None
    try:
        numbers = tuple(float(number) for number in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(isfinite(number) for number in numbers):
        hint = f"for example {option} 500100,5400020,312"
        raise UsageError(option, f"is {text!r}", "three numbers in metres: x,y,z", hint)
    return numbers
