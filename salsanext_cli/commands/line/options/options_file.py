# SPDX-License-Identifier: MIT
"""Options from a file in the working folder, which commands that label and compare share.

What is typed wins, then a variable, then the file. Keys are the options without dashes. Those at
the top are for every command that has the option; a table such as ``[pick]`` is for one command.
"""

import os
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from salsanext_cli.commands.line.options.typer_interface import (
    OF_FILE,
    OF_VARIABLE,
    TYPED,
    USAGE_ERROR,
    source_of,
)
from salsanext_cli.commands.line.options.wrong_values import expected_value
from salsanext_cli.commands.line.output.console import guarded, print_line
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import did_you_mean, printable, shortened
from salsanext_cli.runs.results.query import DATASET_VARIABLE

FILE = Path("salsanext.toml")
COMMANDS_WITH_FILE = ("predict", "uncertainty", "eval", "pick")
"""Commands that read the file."""
ONLY_TYPED = {"cluster", "dry_run", "events", "json", "overwrite", "quiet", "shard", "verbose"}
"""Options of one run: what may replace results or leave the machine is no setting of a folder."""
EXCLUSIVE = (("split", "sequences"), ("jobs", "cluster"), ("count", "names"))
"""Parameters that exclude each other."""
HELP_OPTIONS = {"-h", "--help", "--help-all"}


@guarded
def use_options_file(context: Any, words: list[str], *, json: bool) -> None:
    """Let the options that are neither typed nor variables come from the file, if there is one.

    Parameters
    ----------
    context : typer.Context
        Context of a command whose words are not parsed yet.
    words : list of str
        Words of the command line.
    json : bool
        Whether an error is printed as JSON, which `guarded` reads.

    Raises
    ------
    UsageError
        If the file is no TOML, or has an unknown key or a value that an option cannot have.
    """
    command = str(context.info_name)
    if command not in COMMANDS_WITH_FILE or HELP_OPTIONS.intersection(words):
        return
    if not os.path.lexists(FILE):
        return
    from salsanext_cli.io.files.yaml_toml import read_toml

    content = read_toml(FILE, "command", ())
    commands = context.parent.command.commands
    options = {name: _options(commands[name]) for name in COMMANDS_WITH_FILE}
    offered = options[command]
    values: dict[str, Any] = {}
    for key, value in _settings(content, command, options):
        if key in offered:
            parameter = offered[key]
            values[parameter.name] = _checked(context, key, parameter, value)
    if DATASET_VARIABLE in os.environ:
        # `eval` has no parameter with this variable, and reads it itself.
        values.pop("dataset", None)
    context.default_map = values


def _options(command: Any) -> dict[str, Any]:
    """Return the parameters of a command that the file may set, by key."""
    by_key: dict[str, Any] = {}
    for parameter in command.params:
        if parameter.param_type_name == "option" and parameter.name not in ONLY_TYPED:
            by_key[_long_name(parameter).removeprefix("--")] = parameter
    return by_key


def _long_name(parameter: Any) -> str:
    """Return the name of an option that is not abbreviated."""
    return str(next(name for name in parameter.opts if name.startswith("--")))


def _settings(
    content: Mapping[str, Any], command: str, options: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, Any]]:
    """Yield the keys and values of a command, those of its table last; refuse unknown keys.

    `options`: those of each command, by key.
    """
    keys_of_any = {key for offered in options.values() for key in offered}
    table: Mapping[str, Any] = {}
    for key, value in content.items():
        if key in COMMANDS_WITH_FILE and isinstance(value, dict):
            _require_offered(value, options[key], f"[{key}]")
            table = value if key == command else table
        else:
            _require_offered([key], keys_of_any)
            yield key, value
    yield from table.items()


def _require_offered(keys: Iterable[str], offered: Collection[str], table: str = "") -> None:
    """Refuse keys that are no options; `table`: the table with them, if any."""
    for key in keys:
        if key in offered:
            continue
        problem = f"{table} {key}: no such option".lstrip()
        hint = did_you_mean(key, [*offered, *COMMANDS_WITH_FILE])
        if key.replace("-", "_") in ONLY_TYPED:
            problem = f"{table} {key}: belongs to one run".lstrip()
            hint = f"type --{key}"
        raise UsageError(FILE, problem, hint=hint or "keys are options without the dashes")


def _checked(context: Any, key: str, parameter: Any, value: Any) -> Any:
    """Return a value of the file as the words of a command line; refuse one that cannot be."""
    words = _words(parameter, value)
    try:
        if words is not None:
            parameter.process_value(context, words)
    except USAGE_ERROR:
        words = None
    if words is None:
        expected = "true or false" if parameter.is_flag else expected_value(parameter)
        hint = f"see salsanext {context.info_name} --help"
        raise UsageError(FILE, f"{key} is {shortened(value)}", expected, hint)
    return words


def _words(parameter: Any, value: Any) -> Any:
    """Return what is typed for a value: a text, or several if the option may be given so often.

    A switch has true or false. Other values are texts, numbers, or lists of these, which an option
    that is given once has with commas. None for anything else.
    """
    if parameter.is_flag:
        return value if isinstance(value, bool) else None
    items = value if isinstance(value, list) else [value]
    if any(isinstance(item, bool) or not isinstance(item, str | int | float) for item in items):
        return None
    texts = [str(item) for item in items]
    return texts if parameter.multiple else ",".join(texts)


def settle_options(context: Any) -> None:
    """Let what is typed or a variable replace an option of the file that it excludes; print both.

    With ``--verbose``, all options that are not their defaults are printed with their sources,
    otherwise only those of the file, and with ``--quiet`` none.

    `context`: of a command whose words are parsed.
    """
    if context.info_name not in COMMANDS_WITH_FILE:
        return
    parameters = {parameter.name: parameter for parameter in context.command.params}
    dropped: set[str] = set()
    for pair in EXCLUSIVE:
        sources = {name: source_of(context, name) for name in pair if name in parameters}
        if {TYPED, OF_VARIABLE}.intersection(sources.values()):
            dropped.update(name for name, source in sources.items() if source == OF_FILE)
    for name in dropped:
        context.params[name] = parameters[name].default
    if context.params.get("quiet"):
        return
    texts: dict[str, list[str]] = {}
    for name, parameter in parameters.items():
        source = source_of(context, name)
        if name in dropped or name == "verbose" or parameter.param_type_name != "option":
            continue
        origin = {TYPED: "command line", OF_FILE: str(FILE)}.get(source, "")
        if source == OF_VARIABLE:
            origin = str(parameter.envvar)
        texts.setdefault(origin, []).append(_text(parameter, context.params.get(name)))
    origins = [str(FILE)]
    if context.params.get("verbose"):
        origins = [origin for origin in texts if origin]
    for origin in origins:
        if origin in texts:
            print_line(printable(f"options of {origin}: {' '.join(texts[origin])}"))


def _text(parameter: Any, value: Any) -> str:
    """Return an option with its value as it is typed."""
    name = _long_name(parameter)
    if parameter.is_flag:
        return name
    if parameter.multiple:
        return " ".join(f"{name} {shlex.quote(str(item))}" for item in value)
    words = value if isinstance(value, tuple) else (value,)
    return " ".join([name, *(shlex.quote(str(word)) for word in words)])
