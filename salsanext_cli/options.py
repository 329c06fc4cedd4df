# SPDX-License-Identifier: MIT
"""Options as fields of dataclasses: what a stage takes is what its command offers.

The command line makes its options of the fields, so modules of such dataclasses are light: help
imports neither numpy nor what computes.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar, dataclass_transform

from salsanext_cli.errors import UsageError

Group = TypeVar("Group")


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
    **shown: Any,
) -> Any:
    """Return a field that commands offer: panel and text of the help, names if not the field's.

    `parse` makes the value of the text that was typed, or of None; `shown`: as `typer.Option`
    takes it.
    """
    declared = {"help": text, "rich_help_panel": panel, **shown}
    return field(default=default, metadata={"names": names, "parse": parse, "option": declared})


def argument(text: str, **shown: Any) -> Any:
    """Return a field that commands offer as an argument: text of the help."""
    declared = {"help": text, **shown}
    metadata = {"names": (), "parse": None, "argument": True, "option": declared}
    return field(default=None, metadata=metadata)


def _sequences(text: str | None) -> tuple[str, ...]:
    """Return the names in a list such as 00,08."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    if text is not None and not names:
        raise UsageError("--sequences", repr(text), "names of sequences, such as 00,08")
    return names


selection_option = partial(option, "Selection")


@option_group
class ScanSelection:
    """Selection among the scans that are found, all by default."""

    split: str | None = selection_option("Only the sequences of this split: train, valid or test.")
    sequences: tuple[str, ...] = selection_option(
        "Only these sequences, such as 00,08.", default=(), parse=_sequences
    )
    limit: int | None = selection_option("At most this number of scans, the first ones.")

    def __post_init__(self) -> None:
        if self.split is not None and self.sequences:
            raise UsageError("--split and --sequences", "both given", "one of them")
        if self.limit is not None and self.limit < 1:
            raise UsageError("--limit", str(self.limit), "at least 1")
