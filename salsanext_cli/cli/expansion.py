# SPDX-License-Identifier: MIT
"""Commands with dataclasses as parameters, whose fields are the options that Typer reads."""

import dataclasses
import functools
import importlib
import inspect
from collections.abc import Callable
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer


class Without(frozenset[str]):
    """Fields that a command does not offer: ``Annotated[RunOptions, Without({"shard"})]``."""


class Default(dict[str, Any]):
    """Fields with another default: ``Annotated[ScanSelection, Default(limit=20)]``."""


class Shown(dict[str, dict[str, Any]]):
    """Fields with another help: ``Annotated[ScanSelection, Shown(limit={"help": "…"})]``."""


VALUES = {
    "sensor": "salsanext_cli.sensors.sensor:presets",
    "recipe": "salsanext_cli.training.recipe:presets",
    "colour": "salsanext_cli.results.paths:COLOURS",
    "classes": "salsanext_cli.classes.label_space:BUILT_IN",
    "label_space": "salsanext_cli.classes.label_space:BUILT_IN",
}
"""Home of the values that shells complete, by option: names, or a function that returns them."""


def _completion(home: str) -> Callable[[str], list[str]]:
    def complete(incomplete: str) -> list[str]:
        module, name = home.split(":")
        values = getattr(importlib.import_module(module), name)
        names = values() if callable(values) else values
        return [each for each in names if each.startswith(incomplete)]

    return complete


@dataclasses.dataclass(frozen=True)
class Group:
    """Dataclass that a command takes as a parameter."""

    kind: type
    defaults: dict[str, Any]  # Of all its fields
    offered: dict[str, inspect.Parameter]  # Options by field
    nested: dict[str, "Group"]  # Fields that are such dataclasses themselves

    def fill(self, given: dict[str, Any]) -> Any:
        """Take the values of the options out of what was typed, and build the dataclass."""
        typed = {name: group.fill(given) for name, group in self.nested.items()}
        typed |= {name: given.pop(name) for name in self.offered if name in given}
        for field in dataclasses.fields(self.kind):
            if (parse := field.metadata.get("parse")) and field.name in typed:
                typed[field.name] = parse(typed[field.name])
        return self.kind(**self.defaults | typed)


def expanded(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command with the signature that typer reads: options in the place of dataclasses."""
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Group] = {}
    hints = get_type_hints(command, include_extras=True)
    for name, parameter in inspect.signature(command).parameters.items():
        hint = hints[name]
        kind, *marks = get_args(hint) if get_origin(hint) is Annotated else (hint,)
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            groups[name] = _group(kind, marks)
            parameters += groups[name].offered.values()
        else:
            parameters.append(parameter.replace(annotation=hint, kind=parameter.KEYWORD_ONLY))

    for parameter in parameters:
        kind, *marks = get_args(parameter.annotation) or (None,)
        if kind is bool:
            marks[0].metavar = ""  # A flag takes no value.
        if parameter.name in VALUES:
            marks[0].autocompletion = _completion(VALUES[parameter.name])

    @functools.wraps(command)
    def run(**given: Any) -> None:
        # The last one is `Output`, which decides where messages about the others go.
        filled = {name: groups[name].fill(given) for name in reversed(groups)}
        command(**filled, **given)

    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    vars(run)["__signature__"] = inspect.Signature(parameters)
    return run


def _group(kind: type, marks: list[Any]) -> Group:
    fields = {field.name: field for field in dataclasses.fields(kind) if field.init}
    defaults = {name: field.default for name, field in fields.items()}
    changed: dict[str, dict[str, Any]] = {}
    left_out: set[str] = set()
    for mark in marks:
        if isinstance(mark, Default):
            defaults |= mark
        elif isinstance(mark, Shown):
            changed |= mark
        elif isinstance(mark, Without):
            left_out |= mark
    offered: dict[str, inspect.Parameter] = {}
    nested: dict[str, Group] = {}
    for name, field in fields.items():
        declared = field.metadata
        if not declared and isinstance(field.type, type) and dataclasses.is_dataclass(field.type):
            nested[name] = _group(field.type, marks)
            offered |= nested[name].offered
        if name in left_out or not declared:
            continue
        default, typed = defaults[name], declared.get("typed") or field.type
        if "argument" in declared:
            shown = typer.Argument(**declared["argument"])
        else:
            # A flag of one name, without its contrary.
            flag = [f"--{name.replace('_', '-')}"] if field.type is bool else []
            names = declared["names"] or flag
            shown = typer.Option(*names, **declared["option"] | changed.get(name, {}))
        if declared.get("parse"):
            default, typed = None, str | None
        kind_of, annotation = inspect.Parameter.KEYWORD_ONLY, Annotated[typed, shown]
        offered[name] = inspect.Parameter(name, kind_of, default=default, annotation=annotation)
    return Group(kind, defaults, offered, nested)
