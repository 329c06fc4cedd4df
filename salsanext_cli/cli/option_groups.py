# SPDX-License-Identifier: MIT
"""Groups of options: dataclasses whose fields are expanded into the parameters of a command."""

from __future__ import annotations

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import Annotated, Any, get_args, get_origin, get_type_hints


class OptionGroup:
    """Base of the groups.

    A command that has a parameter of such a type offers the fields as options and receives the
    filled group: ``def command(*, knn: Knn)``.
    """

    __slots__ = ()


class Without(frozenset[str]):
    """Fields that a command leaves out: ``Annotated[Running, Without({"shard"})]``."""


class Default(dict[str, Any]):
    """Fields with another default than in the group: ``Annotated[Selection, Default(limit=4)]``."""


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the signature that typer reads: options in the place of groups."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Callable[[dict[str, Any]], OptionGroup]] = {}
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if isinstance(kind, type) and issubclass(kind, OptionGroup):
            options, groups[name] = _fields(kind, marks)
            parameters += options
        else:
            parameters.append(parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> None:
        filled = {name: fill(given) for name, fill in groups.items()}
        command(**filled, **given)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(run)["__signature__"] = inspect.Signature(parameters)
    return run


def _fields(
    kind: type, marks: list[Any]
) -> tuple[list[inspect.Parameter], Callable[[dict[str, Any]], OptionGroup]]:
    """Return the options of a group, and what takes their values out of all values given."""
    hints = get_type_hints(kind, include_extras=True)
    fields: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(kind)}
    for mark in marks:
        fields |= mark if isinstance(mark, Default) else {}
    left_out = {name for mark in marks if isinstance(mark, Without) for name in mark}
    options = [
        inspect.Parameter(
            name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=hints[name]
        )
        for name, default in fields.items()
        if name not in left_out
    ]

    def fill(given: dict[str, Any]) -> OptionGroup:
        values = fields | {option.name: given.pop(option.name) for option in options}
        group: OptionGroup = kind(**values)
        return group

    return options, fill
