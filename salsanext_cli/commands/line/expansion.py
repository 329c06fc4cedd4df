# SPDX-License-Identifier: MIT
"""Commands with dataclasses as parameters, whose fields are the options that Typer reads."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Mapping
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from salsanext_cli.commands.line.completion import COMPLETERS
from salsanext_cli.commands.line.option_groups import declaration


class Without(frozenset[str]):
    """Fields that a command does not offer: ``Annotated[RunOptions, Without({"shard"})]``."""


class Default(dict[str, Any]):
    """Fields with another default: ``Annotated[ScanSelection, Default(limit=20)]``."""


class Shown(dict[str, dict[str, Any]]):
    """Fields that are declared otherwise: ``Annotated[ScanSelection, Shown(limit={"help": "…"})]``.

    The keys are arguments of `typer.Option`, and ``names``.
    """


Fill = Callable[[dict[str, Any]], Any]
"""Function that builds a dataclass from the values of its options, which it removes."""
METAVARS = {int: "N", float: "NUMBER", Path: "PATH", str: "NAME"}


def _metavar(kind: Any) -> str | None:
    """Return the word for a value of a type in the help."""
    if isinstance(kind, UnionType) or get_origin(kind) is list:
        return _metavar(get_args(kind)[0])
    return "|".join(get_args(kind)) if get_origin(kind) is Literal else METAVARS.get(kind)


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the signature that typer reads: options in the place of dataclasses."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Fill] = {}
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            offered, groups[name] = _group(kind, marks)
            parameters += offered.values()
        elif isinstance(parameter.default, dataclasses.Field):
            declared = parameter.default.metadata
            parameters.append(_offered(name, hint, declared, parameter.default.default))
        else:
            parameters.append(parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**given: Any) -> None:
        # The last group is `Output`, which decides where messages about the others go.
        filled = {name: groups[name](given) for name in reversed(groups)}
        command(**filled, **given)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(run)["__signature__"] = inspect.Signature(parameters)
    return run


def _group(kind: type, marks: list[Any]) -> tuple[dict[str, inspect.Parameter], Fill]:
    """Return the options of a dataclass by field, and the function that builds it."""
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    defaults = {name: field.default for name, field in fields.items()}
    changes: dict[str, dict[str, Any]] = {}
    hidden: set[str] = set()
    for mark in marks:
        if isinstance(mark, Default):
            defaults |= {name: mark[name] for name in fields.keys() & mark}
        elif isinstance(mark, Shown):
            changes |= mark
        elif isinstance(mark, Without):
            hidden |= mark
    offered: dict[str, inspect.Parameter] = {}
    nested: dict[str, Fill] = {}  # Of fields that are such dataclasses themselves
    declared = {name: declaration(kind, field) for name, field in fields.items()}
    for name, field in fields.items():
        how = declared[name]
        if how is not None and name not in hidden:
            offered[name] = _offered(name, field.type, how, defaults[name], changes.get(name))
        elif how is None and isinstance(field.type, type):
            options, nested[name] = _group(field.type, marks)
            offered |= options

    def fill(given: dict[str, Any]) -> Any:
        typed = {name: build(given) for name, build in nested.items()}
        for name in fields:
            if name in offered and name in given:
                value = given.pop(name)
                how = declared[name]
                parse = how["parse"] if how else None
                typed[name] = parse(value) if parse else value
        return kind(**defaults | typed)

    return offered, fill


def _offered(
    name: str,
    kind: Any,
    declared: Mapping[str, Any],
    default: Any,
    changes: Mapping[str, Any] | None = None,
) -> inspect.Parameter:
    """Return the parameter that typer reads for a declaration by `option` or `argument`."""
    if "argument" in declared:
        mark = typer.Argument(**{"metavar": _metavar(kind)} | declared["argument"])
    else:
        # A flag of one name, without its contrary.
        flag = [f"--{name.replace('_', '-')}"] if kind is bool else []
        kind = declared["typed"] or kind
        shown: dict[str, Any] = {"names": declared["names"] or flag, "metavar": _metavar(kind)}
        shown |= declared["option"] | dict(changes or {})
        option = next(iter(shown["names"]), f"--{name.replace('_', '-')}")
        if option in COMPLETERS and get_origin(kind) is not Literal:
            shown["autocompletion"] = COMPLETERS[option]
        mark = typer.Option(*shown.pop("names"), **shown)
        if declared["parse"]:
            default, kind = None, str | None
    default = inspect.Parameter.empty if default is ... else default
    how, annotation = inspect.Parameter.KEYWORD_ONLY, Annotated[kind, mark]
    return inspect.Parameter(name, how, default=default, annotation=annotation)
