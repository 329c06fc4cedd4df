# SPDX-License-Identifier: MIT
"""Interface of typer that it does not document: base classes, and sources of parameters.

Typer contains Click, and does not export these names. This is the only module that takes them from
elsewhere; `help` and `wrong_values` read attributes of the objects that they get.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup

__all__ = [
    "OF_FILE",
    "OF_VARIABLE",
    "TYPED",
    "USAGE_ERROR",
    "TyperCommand",
    "TyperGroup",
    "is_typed",
    "source_of",
    "stating_command",
]

USAGE_ERROR = cast("type[Exception]", typer.BadParameter.__base__)
"""Errors of the command line, one kind of which typer exports."""
TYPED = "COMMANDLINE"
OF_VARIABLE = "ENVIRONMENT"
OF_FILE = "DEFAULT_MAP"
"""Names of the sources of parameters: typed, from a variable, from the options file."""


@contextmanager
def stating_command(context: Any) -> Iterator[None]:
    """Add the command to errors that have none, those of options without their values."""
    try:
        yield
    except USAGE_ERROR as error:
        stated: Any = error
        stated.ctx = stated.ctx or context
        raise


def source_of(context: Any, parameter: str) -> str:
    """Return the name of the source of a parameter; empty before it is parsed."""
    source = context.get_parameter_source(parameter)
    return "" if source is None else str(source.name)


def is_typed(context: Any, parameter: str) -> bool:
    """Return whether a parameter was typed, and is not set by its variable or its default."""
    return source_of(context, parameter) == TYPED
