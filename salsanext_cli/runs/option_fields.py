# SPDX-License-Identifier: MIT
"""Command-line options as fields of dataclasses, which stages take as arguments.

Modules with such dataclasses import nothing heavy, since the help of a command imports them.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar, dataclass_transform

from salsanext_cli.core.errors import UsageError

Group = TypeVar("Group")

MAX_REACH = 1000  # Largest reach of `FusionReach`, in scans, each of some megabytes
MAX_WINDOW_PX = 63  # Largest side of the window of `KnnParameters`, in pixels


@dataclass_transform(frozen_default=True)
def option_group(kind: type[Group]) -> type[Group]:
    """Turn a class into a dataclass whose fields, made by `option`, commands offer."""
    return dataclass(frozen=True, slots=True)(kind)


def option(
    text: str,
    *names: str,
    panel: str = "Options",
    default: Any = None,
    parse: Callable[[str | None], Any] | None = None,
    typed: Any = None,
    **shown: Any,
) -> Any:
    """Return a field, or the default of a parameter, that commands offer as an option.

    `text` is the help; `names`: if not the name of the field; `default`: ``...`` if required;
    `parse` makes the value from the text that was typed, or from None; `typed`: type of that text,
    if not that of the field; `shown`: further arguments of `typer.Option`.
    """
    declared = {"help": text, "rich_help_panel": panel, **shown}
    metadata = {"names": names, "parse": parse, "typed": typed, "option": declared}
    return field(default=default, metadata=metadata)


def argument(text: str, *, default: Any = None, **shown: Any) -> Any:
    """Return the default of a parameter that a command offers as an argument, like `option`."""
    return field(default=default, metadata={"argument": {"help": text, **shown}})


def names_in(text: str | None, option: str, example: str) -> tuple[str, ...]:
    """Return the comma-separated names in the value of an option, such as ``00,08``."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    if text is not None and not names:
        raise UsageError(option, f"{text!r} contains no name", f"names such as {example}")
    return names


selection_option = partial(option, panel="Selection")
network_option = partial(option, panel="Network")


@option_group
class ScanSelection:
    """Selection among the scans of a source; all of them by default."""

    split: str | None = selection_option(
        "Only the sequences of this split.", metavar="train|valid|test"
    )
    sequences: tuple[str, ...] = selection_option(
        "Only these sequences, such as 00,08.",
        default=(),
        parse=partial(names_in, option="--sequences", example="00,08"),
        metavar="NAMES",
    )
    limit: int | None = selection_option("Only the first N scans.")

    def __post_init__(self) -> None:
        if self.split is not None and self.sequences:
            raise UsageError("--split and --sequences", "both were given", "one of them")
        if self.limit is not None and self.limit < 1:
            raise UsageError("--limit", f"the number of scans is {self.limit}", "at least 1")


@option_group
class KnnParameters:
    """Settings of the kNN refinement; the defaults are those of RangeNet++.

    The pixel of the point itself is one of the `k` neighbours. The side of the window is odd.
    """

    k: int = network_option("Number of neighbours that vote.", "--knn-k", default=5)
    window: int = network_option(
        "Side of the window of neighbours, in pixels.", "--knn-window", default=5
    )
    sigma: float = network_option(
        "Standard deviation of the Gaussian weights, in pixels.", "--knn-sigma", default=1.0
    )
    cutoff: float = network_option(
        "Maximum difference in range between a point and a neighbour, in metres.",
        "--knn-cutoff",
        default=1.0,
    )

    def __post_init__(self) -> None:
        window, most = self.window, self.window**2
        is_odd = 1 <= window <= MAX_WINDOW_PX and window % 2 == 1
        conditions = (
            ("window", is_odd, f"an odd number from 1 to {MAX_WINDOW_PX}"),
            ("k", 1 <= self.k <= most, f"1 to {most} neighbours in a window of {window} pixels"),
            ("sigma", 0 < self.sigma < math.inf, "a finite number above 0"),
            ("cutoff", self.cutoff >= 0, "0 or more metres"),
        )
        for name, holds, expected in conditions:
            if not holds:
                raise UsageError(f"--knn-{name}", f"the value is {getattr(self, name)}", expected)


@option_group
class FusionReach:
    """Number of scans along a drive that vote for each other's labels."""

    reach: int = option("Number of scans before and after a scan that vote.", default=20)
    movable_reach: int = option(
        "The same for vehicles, people and riders that may have moved.", default=3
    )

    def __post_init__(self) -> None:
        if not 0 <= self.movable_reach <= self.reach <= MAX_REACH:
            problem = f"the values are {self.reach} and {self.movable_reach}"
            expected = f"0 ≤ movable reach ≤ reach ≤ {MAX_REACH}"
            raise UsageError("--reach and --movable-reach", problem, expected)
