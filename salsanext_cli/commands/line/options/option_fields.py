# SPDX-License-Identifier: MIT
"""Declaration of options and arguments of commands, as Typer reads them from `expansion`."""

from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, replace
from functools import partial
from typing import Any, TypeVar, dataclass_transform

from salsanext_cli.core.errors import UsageError

Options = TypeVar("Options")
DECLARATION = "declaration"
"""Key of the declaration in the metadata of a field."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DeclarationChange:
    """What one command has otherwise of an option; None for what stays."""

    names: tuple[str, ...] | None = None
    help: str | None = None
    show_default: str | None = None  # Default, in words
    metavar: str | None = None
    parse: Callable[[str | None], Any] | None = None  # As of `Declaration`


@dataclass(frozen=True, slots=True, kw_only=True)
class Declaration:
    """How commands offer a parameter or a field: as an option, or as an argument.

    Attributes
    ----------
    typer_arguments : mapping
        Arguments of `typer.Option` or `typer.Argument`, such as ``help``.
    is_argument : bool
        Whether it is an argument, which is typed without a name.
    names : tuple of str
        Names of the option; empty for that of the field.
    parse : callable, optional
        Function that makes the value from the text that was typed, or from None.
    typed : type, optional
        Type of that text; None for that of the field.
    """

    typer_arguments: Mapping[str, Any]
    is_argument: bool = False
    names: tuple[str, ...] = ()
    parse: Callable[[str | None], Any] | None = None
    typed: Any = None

    def changed(self, change: DeclarationChange) -> "Declaration":
        """Return the declaration with what one command has otherwise."""
        texts = {
            "help": change.help,
            "show_default": change.show_default,
            "metavar": change.metavar,
        }
        changed_texts = {key: text for key, text in texts.items() if text is not None}
        return replace(
            self,
            names=self.names if change.names is None else change.names,
            parse=change.parse or self.parse,
            typer_arguments={**self.typer_arguments, **changed_texts},
        )


@dataclass_transform(frozen_default=True)
def option_group(kind: type[Options]) -> type[Options]:
    """Turn a class into a dataclass whose fields, made by `option`, commands offer."""
    return dataclass(frozen=True, slots=True)(kind)


def option_declaration(
    text: str,
    *names: str,
    panel: str = "Options",
    parse: Callable[[str | None], Any] | None = None,
    typed: Any = None,
    **typer_arguments: Any,
) -> Declaration:
    """Return the declaration of an option.

    Parameters
    ----------
    text : str
        Help.
    *names : str
        Names of the option, if not that of the field.
    panel : str
        Heading of the help under which the option is listed.
    parse : callable, optional
        As of `Declaration`.
    typed : type, optional
        As of `Declaration`.
    **typer_arguments
        Further arguments of `typer.Option`.

    Returns
    -------
    Declaration
    """
    return Declaration(
        typer_arguments={"help": text, "rich_help_panel": panel, **typer_arguments},
        names=names,
        parse=parse,
        typed=typed,
    )


def declared_field(declaration: Declaration, default: Any) -> Any:
    """Return a field, or the default of a parameter, with a declaration.

    `default`: of the option or argument; ``...`` if it is required.
    """
    return field(default=default, metadata={DECLARATION: declaration})


def declaration_in(declared: object) -> Declaration | None:
    """Return the declaration in what `declared_field` returned; None in any other object."""
    return declared.metadata.get(DECLARATION) if isinstance(declared, Field) else None


def option(text: str, *names: str, default: Any = None, **declaration: Any) -> Any:
    """Return a field, or the default of a parameter, that commands offer as an option.

    `declaration`: further arguments of `option_declaration`.
    """
    return declared_field(option_declaration(text, *names, **declaration), default)


def argument(text: str, *, default: Any = None, **typer_arguments: Any) -> Any:
    """Return the default of a parameter that a command offers as an argument, like `option`."""
    declaration = Declaration(typer_arguments={"help": text, **typer_arguments}, is_argument=True)
    return declared_field(declaration, default)


def names_in(text: str | None, option: str, example: str) -> tuple[str, ...]:
    """Return the comma-separated names in the value of an option, such as ``00,08``."""
    names = tuple(name.strip() for name in (text or "").split(",") if name.strip())
    if text is not None and not names:
        raise UsageError(option, f"{text!r} contains no name", f"names such as {example}")
    return names


selection_option = partial(option, panel="Selection")
network_option = partial(option, panel="Network")
running_option = partial(option, panel="Running")
