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

__all__ = ["USAGE_ERROR", "TyperCommand", "TyperGroup", "is_typed", "stating_command"]

USAGE_ERROR = cast("type[Exception]", typer.BadParameter.__base__)
"""Errors of the command line, one kind of which typer exports."""
TYPED = "COMMANDLINE"
"""Name of the source of parameters that were typed."""


@contextmanager
def stating_command(context: Any) -> Iterator[None]:
    """Add the command to errors that have none, those of options without their values."""
    try:
        yield
    except USAGE_ERROR as error:
        stated: Any = error
        stated.ctx = stated.ctx or context
        raise


def is_typed(context: Any, parameter: str) -> bool:
    """Return whether a parameter was typed, and is not set by its variable or its default."""
    source = context.get_parameter_source(parameter)
    return source is not None and source.name == TYPED
