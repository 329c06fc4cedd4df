# SPDX-License-Identifier: MIT
"""Errors of typer about the command line, in the words of this program."""

import os
from collections.abc import Sequence
from typing import Any

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import nearest, shortened

MIN_SIMILARITY = 0.75  # Of a misspelt option and the option that may be meant, 0…1
SAME_PURPOSE = {"--limit": "--subset", "--subset": "--limit"}
"""Option typed by mistake, and the option of this command for the same purpose."""
NUMBERS = {"N": "a whole number", "NUMBER": "a number"}
"""What is expected, by the word for a value in the help."""


def usage_error(raised: Any, arguments: Sequence[str]) -> UsageError:
    """Return the error for an error of typer about a command line.

    Parameters
    ----------
    raised : Exception
        Error of typer.
    arguments : sequence of str
        Words of the command line.

    Returns
    -------
    UsageError
    """
    path = getattr(raised.ctx, "command_path", "salsanext")
    option_name = getattr(raised, "option_name", "")
    if option_name:
        parameters = _parameters(raised.ctx.command)
        if option_name in parameters:
            return _missing_value(parameters[option_name], option_name, path)
        return _unknown_option(option_name, [*parameters], path)
    parameter: Any = getattr(raised, "param", None)
    value = None if parameter is None else _value(parameter, arguments)
    expected = "" if parameter is None else expected_value(parameter)
    if value is not None and expected:
        return _wrong_value(parameter, value, expected, path)
    message = raised.format_message().rstrip(".")
    problem = message[:1].lower() + message[1:]
    return UsageError(path, problem, hint=f"see {path} --help")


def _wrong_value(parameter: Any, value: str, expected: str, path: str) -> UsageError:
    """Return the error about the value of an option of a command."""
    long_name = max(parameter.opts, key=len)
    choices = str(parameter.metavar).split("|")
    likely = nearest(value, choices) if len(choices) > 1 else None
    hint = f"did you mean {long_name} {likely}?" if likely else f"see {path} --help"
    return UsageError(long_name, f"is {shortened(value)}", expected, hint)


def _parameters(command: Any) -> dict[str, Any]:
    """Return the parameters of a command by each of their names."""
    return {
        name: parameter
        for parameter in command.params
        for name in (*parameter.opts, *parameter.secondary_opts)
    }


def _missing_value(parameter: Any, name: str, path: str) -> UsageError:
    """Return the error about an option at the end of a command line, or a flag with a value."""
    hint = f"see {path} --help"
    if parameter.is_flag:
        return UsageError(name, "does not take a value", hint=hint)
    return UsageError(name, "needs a value", expected_value(parameter), hint)


def _unknown_option(name: str, offered: Sequence[str], path: str) -> UsageError:
    """Return the error about an option that a command does not offer."""
    likely = SAME_PURPOSE.get(name, "")
    if likely not in offered:
        # Compare without the dashes, which all options share.
        words = {option.removeprefix("--"): option for option in offered if option[:2] == "--"}
        likely = words.get(nearest(name.removeprefix("--"), words, MIN_SIMILARITY), "")
    hint = f"did you mean {likely}?" if likely else f"see {path} --help"
    return UsageError(path, f"no such option: {name}", hint=hint)


def _value(parameter: Any, arguments: Sequence[str]) -> str | None:
    """Return the value of an option as it was typed, or that of its variable."""
    # The last one that is typed counts.
    for place, word in reversed([*enumerate(arguments)]):
        name, equals, value = word.partition("=")
        if name not in parameter.opts:
            continue
        if equals:
            return value
        return arguments[place + 1] if place + 1 < len(arguments) else None
    return os.environ.get(parameter.envvar) if isinstance(parameter.envvar, str) else None


def expected_value(parameter: Any) -> str:
    """Return what the value of an option must be; empty if that is not known."""
    least = getattr(parameter, "min", None)
    most = getattr(parameter, "max", None)
    if least is not None and most is not None:
        return f"{least} to {most}"
    choices = str(parameter.metavar).split("|")
    if len(choices) > 1 and all(choice.islower() for choice in choices):
        return f"{', '.join(choices[:-1])} or {choices[-1]}"
    return NUMBERS.get(str(parameter.metavar), "")
