# SPDX-License-Identifier: MIT
"""Groups of options: dataclasses whose fields are expanded into the parameters of a command."""

import dataclasses
import functools
import inspect
from collections.abc import Callable
from typing import (
    Annotated,
    Any,
    TypeVar,
    dataclass_transform,
    get_args,
    get_origin,
    get_type_hints,
)

import typer

Group = TypeVar("Group")


class Without(frozenset[str]):
    """Fields that a command does not offer: ``Annotated[Running, Without({"shard"})]``."""


class Default(dict[str, Any]):
    """Fields with another default than in the group: ``Annotated[Selection, Default(limit=4)]``."""


@dataclass_transform(frozen_default=True)
def option_group(kind: type[Group]) -> type[Group]:
    """Turn a class into a dataclass whose fields, made by `option` or `argument`, commands offer.

    A command that has a parameter of such a type offers the fields as options and receives the
    filled group: ``def command(*, knn: Knn)``.
    """
    return dataclasses.dataclass(frozen=True, slots=True)(kind)


def option(panel: str, text: str, *names: str, default: Any = None, **settings: Any) -> Any:
    """Return a field of a group: panel and text of the help, names if not that of the field."""
    declared = typer.Option(*names, help=text, rich_help_panel=panel, **settings)
    return dataclasses.field(default=default, metadata={"option": declared})


def argument(text: str, **settings: Any) -> Any:
    """Return a field of a group that is an argument of commands: text of the help."""
    declared = typer.Argument(help=text, **settings)
    return dataclasses.field(default=None, metadata={"option": declared})


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the signature that typer reads: options in the place of groups."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, tuple[type, dict[str, Any], list[str]]] = {}
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            options, defaults = _fields(kind, marks)
            parameters += options
            groups[name] = kind, defaults, [option.name for option in options]
        else:
            parameters.append(parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> None:
        filled = {
            name: kind(**defaults | {field: given.pop(field) for field in offered})
            for name, (kind, defaults, offered) in groups.items()
        }
        command(**filled, **given)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(run)["__signature__"] = inspect.Signature(parameters)
    return run


def _fields(kind: type, marks: list[Any]) -> tuple[list[inspect.Parameter], dict[str, Any]]:
    """Return the options of a group that a command offers, and the defaults of all fields."""
    hints = get_type_hints(kind)
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    defaults = {name: field.default for name, field in fields.items()}
    left_out: set[str] = set()
    for mark in marks:
        if isinstance(mark, Default):
            defaults |= mark
        elif isinstance(mark, Without):
            left_out |= mark
    options = [
        inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=defaults[name],
            annotation=Annotated[hints[name], field.metadata["option"]],
        )
        for name, field in fields.items()
        if name not in left_out
    ]
    return options, defaults
