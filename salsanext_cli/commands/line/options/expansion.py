# SPDX-License-Identifier: MIT
"""Commands with dataclasses as parameters, whose fields are the options that Typer reads."""

import dataclasses
import functools
import inspect
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import typer

from salsanext_cli.commands.line.options.completion import COMPLETERS
from salsanext_cli.commands.line.options.option_fields import (
    Declaration,
    DeclarationChange,
    declaration_in,
)
from salsanext_cli.commands.line.options.option_groups import declaration_of


class Without(frozenset[str]):
    """Fields that a command does not offer: ``Annotated[RunOptions, Without({"shard"})]``."""


class Default(dict[str, Any]):
    """Fields with another default: ``Annotated[ScanSelection, Default(limit=20)]``."""


class Declared(dict[str, DeclarationChange]):
    """Fields with another declaration, ``Annotated[ScanSelection, Declared(limit=SUBSET)]``."""


METAVARS = {int: "N", float: "NUMBER", Path: "PATH", str: "NAME"}


def _metavar(kind: Any) -> str | None:
    """Return the word for a value of a type in the help."""
    if isinstance(kind, UnionType) or get_origin(kind) is list:
        return _metavar(get_args(kind)[0])
    if get_origin(kind) is Literal:
        return "|".join(get_args(kind))
    return METAVARS.get(kind)


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the signature that typer reads: options in the place of dataclasses."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, OptionGroup] = {}
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            groups[name] = OptionGroup.from_dataclass(kind, marks)
            parameters += groups[name].parameters()
        elif declaration := declaration_in(parameter.default):
            parameters.append(_parameter(name, hint, declaration, parameter.default.default))
        else:
            parameters.append(parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY))

    @functools.wraps(command)
    def run(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group.fill(values)
        command(**values)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(run)["__signature__"] = inspect.Signature(parameters)
    return run


@dataclasses.dataclass(slots=True, kw_only=True)
class OptionGroup:
    """Dataclass whose fields a command offers as options.

    Attributes
    ----------
    kind : type
        The dataclass.
    defaults : dict
        Default of each field by name.
    options : dict
        The parameter that typer reads, by the name of its field.
    parsers : dict
        Function that makes the value of a field from the text that was typed, where it has one.
    nested : dict
        Fields that are such dataclasses themselves.
    """

    kind: type
    defaults: dict[str, Any]
    options: dict[str, inspect.Parameter] = dataclasses.field(default_factory=dict)
    parsers: dict[str, Callable[[str | None], Any]] = dataclasses.field(default_factory=dict)
    nested: dict[str, "OptionGroup"] = dataclasses.field(default_factory=dict)

    @classmethod
    def from_dataclass(cls, kind: type, marks: Sequence[Any]) -> "OptionGroup":
        """Return the options of a dataclass, as `Default`, `Declared` and `Without` change them."""
        fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
        changes = Changes.from_marks(marks)
        defaults = {name: field.default for name, field in fields.items()}
        group = cls(kind=kind, defaults=defaults)
        for name, field in fields.items():
            defaults[name] = changes.defaults.get(name, field.default)
            declaration = declaration_of(kind, field)
            if declaration is None and isinstance(field.type, type):
                group.nested[name] = OptionGroup.from_dataclass(field.type, marks)
            elif declaration is not None and name not in changes.hidden:
                if name in changes.declarations:
                    declaration = declaration.changed(changes.declarations[name])
                group.options[name] = _parameter(name, field.type, declaration, defaults[name])
                if declaration.parse:
                    group.parsers[name] = declaration.parse
        return group

    def parameters(self) -> Iterator[inspect.Parameter]:
        """Yield the options in the order of the fields."""
        for name in self.defaults:
            if name in self.options:
                yield self.options[name]
            elif name in self.nested:
                yield from self.nested[name].parameters()

    def fill(self, values: dict[str, Any]) -> Any:
        """Build the dataclass from the values of its options, which are removed."""
        arguments = dict(self.defaults)
        for name, group in self.nested.items():
            arguments[name] = group.fill(values)
        for name in self.options:
            if name in values:
                value = values.pop(name)
                parse = self.parsers.get(name)
                arguments[name] = parse(value) if parse else value
        return self.kind(**arguments)


@dataclasses.dataclass(slots=True, kw_only=True)
class Changes:
    """Changes of the options of a dataclass, from the marks of its annotation."""

    defaults: dict[str, Any] = dataclasses.field(default_factory=dict)
    declarations: dict[str, DeclarationChange] = dataclasses.field(default_factory=dict)
    hidden: set[str] = dataclasses.field(default_factory=set)

    @classmethod
    def from_marks(cls, marks: Sequence[Any]) -> "Changes":
        """Collect the changes; later marks count."""
        changes = cls()
        for mark in marks:
            if isinstance(mark, Default):
                changes.defaults |= mark
            elif isinstance(mark, Declared):
                changes.declarations |= mark
            elif isinstance(mark, Without):
                changes.hidden |= mark
        return changes


def _parameter(name: str, kind: Any, declaration: Declaration, default: Any) -> inspect.Parameter:
    """Return the parameter that typer reads for a declaration by `option` or `argument`."""
    mark: typer.models.ParameterInfo
    if declaration.is_argument:
        mark = typer.Argument(**{"metavar": _metavar(kind), **declaration.typer_arguments})
    else:
        kind = declaration.typed or kind
        mark = _option(name, kind, declaration)
        if declaration.parse:
            default = None
            kind = str | None
    return inspect.Parameter(
        name,
        inspect.Parameter.KEYWORD_ONLY,
        default=inspect.Parameter.empty if default is ... else default,
        annotation=Annotated[kind, mark],
    )


def _option(name: str, kind: Any, declaration: Declaration) -> typer.models.OptionInfo:
    """Return typer's declaration of an option."""
    option_name = f"--{name.replace('_', '-')}"
    arguments = {"metavar": _metavar(kind), **declaration.typer_arguments}
    names = declaration.names
    if not names and kind is bool:
        # A flag of one name, without its contrary.
        names = (option_name,)
    first_name = names[0] if names else option_name
    if first_name in COMPLETERS and get_origin(kind) is not Literal:
        arguments["autocompletion"] = COMPLETERS[first_name]
    return typer.Option(*names, **arguments)
