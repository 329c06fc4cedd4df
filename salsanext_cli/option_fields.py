# SPDX-License-Identifier: MIT
"""Options as fields of dataclasses: what a stage takes is what its command offers.

The command line makes its options of the fields, so modules of such dataclasses are light: help
imports neither numpy nor what computes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar, dataclass_transform

from salsanext_cli.errors import UsageError

Group = TypeVar("Group")

MAX_REACH = 1000  # Largest reach of `FusionReach`, in scans, each of some megabytes
MAX_WINDOW_PX = 63  # Largest side of the window of `KnnParameters`, in pixels


@dataclass_transform(frozen_default=True)
def option_group(kind: type[Group]) -> type[Group]:
    """Turn a class into a dataclass whose fields, made by `option`, commands offer."""
    return dataclass(frozen=True, slots=True)(kind)


def option(
    panel: str,
    text: str,
    *names: str,
    default: Any = None,
    parse: Callable[[str | None], Any] | None = None,
    typed: Any = None,
    **shown: Any,
) -> Any:
    """Return a field that commands offer: panel and text of the help, names if not the field's.

    `parse` makes the value of the text that was typed, or of None; `typed`: type of what is typed,
    if not that of the field; `shown`: as `typer.Option` takes it.
    """
    declared = {"help": text, "rich_help_panel": panel, **shown}
    metadata = {"names": names, "parse": parse, "typed": typed, "option": declared}
    return field(default=default, metadata=metadata)


def argument(text: str, **shown: Any) -> Any:
    """Return a field that commands offer as an argument: text of the help."""
    return field(default=None, metadata={"argument": {"help": text, **shown}})


def names_in(text: str | None, option: str, example: str) -> tuple[str, ...]:
    """Return the names in a list, such as 00,08, that an option was given."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    if text is not None and not names:
        raise UsageError(option, repr(text), f"names such as {example}")
    return names


own_option = partial(option, "Options")
selection_option = partial(option, "Selection")
network_option = partial(option, "Network")


@option_group
class ScanSelection:
    """Selection among the scans that are found, all by default."""

    split: str | None = selection_option("Only the sequences of this split: train, valid or test.")
    sequences: tuple[str, ...] = selection_option(
        "Only these sequences, such as 00,08.",
        default=(),
        parse=partial(names_in, option="--sequences", example="00,08"),
    )
    limit: int | None = selection_option("At most this number of scans, the first ones.")

    def __post_init__(self) -> None:
        if self.split is not None and self.sequences:
            raise UsageError("--split and --sequences", "both given", "one of them")
        if self.limit is not None and self.limit < 1:
            raise UsageError("--limit", str(self.limit), "at least 1")


@option_group
class KnnParameters:
    """Settings of the neighbourhood and of the vote; the defaults are the published ones.

    The point's own pixel is one of the `k` neighbours, and the side of the window is odd.
    """

    k: int = network_option("Number of neighbours that vote.", "--knn-k", default=5)
    window: int = network_option(
        "Side of the window of neighbours, in pixels.", "--knn-window", default=5
    )
    sigma: float = network_option(
        "Standard deviation of the Gaussian weights, in pixels.", "--knn-sigma", default=1.0
    )
    cutoff: float = network_option(
        "Maximum range difference of a neighbour, in metres.", "--knn-cutoff", default=1.0
    )

    def __post_init__(self) -> None:
        window, most = self.window, self.window**2
        is_odd = 1 <= window <= MAX_WINDOW_PX and window % 2 == 1
        conditions = (
            ("window", is_odd, f"an odd window from 1 to {MAX_WINDOW_PX}"),
            ("k", 1 <= self.k <= most, f"1 ≤ k ≤ {most} neighbours in a window of {window}"),
            ("sigma", 0 < self.sigma < math.inf, "a finite sigma above 0 pixels"),
            ("cutoff", self.cutoff >= 0, "a cutoff ≥ 0 metres"),
        )
        for name, holds, expected in conditions:
            if not holds:
                raise UsageError("knn", f"{name} {getattr(self, name)}", expected)


@option_group
class FusionReach:
    """Number of scans along a drive that vote for each other's labels."""

    reach: int = option(
        "Options", "Scans before and after each that vote for its labels.", default=20
    )
    movable_reach: int = option(
        "Options",
        "Of these, those that vote for vehicles, people and riders not seen to stand.",
        default=3,
    )

    def __post_init__(self) -> None:
        if not 0 <= self.movable_reach <= self.reach <= MAX_REACH:
            found, expected = f"{self.movable_reach} of {self.reach} scans", "0 ≤ movable ≤ reach"
            raise UsageError("--reach and --movable-reach", found, f"{expected} ≤ {MAX_REACH}")
