# SPDX-License-Identifier: MIT
"""Read the output of commands, and run Python as a user does."""

import json
import logging
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner, Result

from salsanext_cli.commands.line.app import app

PAGE_OF_JSON = Path(__file__).parents[2] / "docs/reference/json.md"


@contextmanager
def logger_as_before() -> Iterator[None]:
    """Leave the logger as it was, which a command sets up for the whole process."""
    logger = logging.getLogger("salsanext_cli")
    level, handlers = logger.level, list(logger.handlers)
    yield
    logger.setLevel(level)
    logger.handlers[:] = handlers


built = cache(typer.main.get_command)
"""Return the command line of a program; to build it takes longer than many commands."""


def invoked(program: typer.Typer, *words: object, **options: Any) -> Result:
    """Run a program of the command line in this process."""
    with logger_as_before(), pytest.MonkeyPatch.context() as patch:
        # The runner builds the program for each call.
        patch.setattr("typer.testing._get_command", built, raising=False)
        return CliRunner().invoke(program, [str(word) for word in words], **options)


def called(*words: object, status: int | None = 0) -> Result:
    """Run a command in this process; fail if it ends with another status, unless it is None."""
    result = invoked(app, *words)
    assert status is None or result.exit_code == status, (words, result.output)
    return result


def every_command() -> dict[str, Callable[..., None]]:
    """Return the function of every command, as typer reads it, by its full name."""
    commands: dict[str, Any] = {c.name or "": c.callback for c in app.registered_commands}
    for group in app.registered_groups:
        members = group.typer_instance.registered_commands if group.typer_instance else []
        commands |= {f"{group.name} {member.name}": member.callback for member in members}
    return commands


def root() -> Any:
    """Return the command line as a whole."""
    return built(app)


def parsed(name: str) -> Any:
    """Return a command as the command line knows it, by its full name."""
    command = root()
    for word in name.split():
        command = command.commands[word]
    return command


@cache
def documented_keys(stage: str) -> frozenset[str]:
    """Return the keys that the page on JSON lists for a stage or section; for errors if empty."""
    head, *rest = re.split(r"^## (.+)\n", PAGE_OF_JSON.read_text("utf-8"), flags=re.MULTILINE)
    sections = dict(zip(rest[::2], rest[1::2], strict=True))
    of_scans = sections["Commands on scans"]
    row = re.search(rf"^\| `{stage}` \|(.*)$", sections["Other commands"], re.MULTILINE)
    if not stage:
        text = sections["Errors"]
    elif f"`{stage}`" in of_scans.partition("\n\n|")[0]:
        text = of_scans
    elif row:
        text = row[1] + (sections["eval"] if "the keys of `eval`" in row[1] else "")
    else:
        text = sections[stage]
    return frozenset(re.findall(r"[`\"](\w+)[`\"]", head + text))


def only_json(result: Result) -> dict[str, Any]:
    """Return the one JSON object on stdout; fail if the page on JSON does not list its keys."""
    assert result.stdout.count("\n") == 1, result.stdout
    data = json.loads(result.stdout, parse_constant=pytest.fail)
    assert isinstance(data, dict)
    section = "Dry runs" if data.get("dry_run") else data.get("stage", "")
    assert {*data} - documented_keys(section) == set()
    # Strict readers refuse halves of characters.
    json.dumps(data, ensure_ascii=False).encode("utf-8")
    return data


def subject(result: Result) -> str:
    """Return the subject of the one error on stderr, which a line with a hint may follow."""
    error, *hint = result.stderr.splitlines()
    assert error.startswith("error: "), result.stderr
    assert all(line.startswith("hint: ") for line in hint)
    assert len(hint) <= 1
    return error.removeprefix("error: ").partition(": ")[0]


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in another process."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, **environment},
    )
