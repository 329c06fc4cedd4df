# SPDX-License-Identifier: MIT
"""Declaration of options and arguments of commands, as Typer reads them from `expansion`."""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, TypeVar, dataclass_transform

from salsanext_cli.core.errors import UsageError

Options = TypeVar("Options")


@dataclass_transform(frozen_default=True)
def option_group(kind: type[Options]) -> type[Options]:
    """Turn a class into a dataclass whose fields, made by `option`, commands offer."""
    return dataclass(frozen=True, slots=True)(kind)


def option(
    text: str,
    *names: str,
    panel: str = "Options",
    default: Any = None,
    parse: Callable[[str | None], Any] | None = None,
    typed: Any = None,
    **declaration: Any,
) -> Any:
    """Return a field, or the default of a parameter, that commands offer as an option.

    Parameters
    ----------
    text : str
        Help.
    *names : str
        Names of the option, if not that of the field.
    panel : str
        Heading of the help under which the option is listed.
    default : object
        Default of the field; ``...`` if the option is required.
    parse : callable, optional
        Function that makes the value from the text that was typed, or from None.
    typed : type, optional
        Type of that text, if not that of the field.
    **declaration
        Further arguments of `typer.Option`.

    Returns
    -------
    dataclasses.Field
    """
    arguments = {"help": text, "rich_help_panel": panel, **declaration}
    metadata = {"names": names, "parse": parse, "typed": typed, "option": arguments}
    return field(default=default, metadata=metadata)


def argument(text: str, *, default: Any = None, **declaration: Any) -> Any:
    """Return the default of a parameter that a command offers as an argument, like `option`."""
    return field(default=default, metadata={"argument": {"help": text, **declaration}})


def names_in(text: str | None, option: str, example: str) -> tuple[str, ...]:
    """Return the comma-separated names in the value of an option, such as ``00,08``."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    if text is not None and not names:
        raise UsageError(option, f"{text!r} contains no name", f"names such as {example}")
    return names


selection_option = partial(option, panel="Selection")
network_option = partial(option, panel="Network")
running_option = partial(option, panel="Running")
