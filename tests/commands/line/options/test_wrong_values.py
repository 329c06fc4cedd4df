# SPDX-License-Identifier: MIT
"""Options without their values, and flags with one."""

from collections.abc import Iterator
from typing import Any

import pytest
from command_line import built, only_json

from salsanext_cli.commands.line.app import app


def commands(group: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Any]]:
    """Yield the words and the parameters of each command of a group, and of the groups in it."""
    for name, command in group.commands.items():
        if hasattr(command, "commands"):
            yield from commands(command, (*words, name))
        else:
            yield (*words, name), command.params


COMMANDS = dict(commands(built(app)))


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_an_option_at_the_end_needs_its_value_and_a_flag_takes_none(run, words):
    options = [p for p in COMMANDS[words] if p.param_type_name == "option"]
    assert options
    for option in options:
        name = max(option.opts, key=len)
        last_word = f"{name}=2" if option.is_flag else name
        error = only_json(run(*words, "--json", last_word, status=2))
        problem = "does not take a value" if option.is_flag else "needs a value"
        assert error["error"].startswith(f"{name}: {problem}")
        assert " ".join(words) in error["hint"]


def test_the_program_takes_no_value_for_its_version(run):
    result = run("--version=2", status=2)
    assert result.stderr.startswith("error: --version: does not take a value\n")
