# SPDX-License-Identifier: MIT
"""Read what commands print, and run Python as a user does."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import pytest
import typer
from typer.testing import Result

from salsanext_cli.cli.app import app


def every_command() -> dict[str, Callable[..., None]]:
    """Return the function of every command, as typer reads it, by its full name."""
    found: dict[str, Any] = {c.name or "": c.callback for c in app.registered_commands}
    for group in app.registered_groups:
        members = group.typer_instance.registered_commands if group.typer_instance else []
        found |= {f"{group.name} {member.name}": member.callback for member in members}
    return found


@cache
def root() -> Any:
    """Return the command line as a whole; it takes a tenth of a second to build."""
    return typer.main.get_command(app)


def parsed(name: str) -> Any:
    """Return a command as the command line knows it, by its full name."""
    command = root()
    for word in name.split():
        command = command.commands[word]
    return command


def only_json(result: Result) -> dict[str, Any]:
    """Return the one JSON object on stdout."""
    assert result.stdout.count("\n") == 1, result.stdout
    found = json.loads(result.stdout, parse_constant=pytest.fail)
    assert isinstance(found, dict)
    # Strict readers refuse halves of characters.
    json.dumps(found, ensure_ascii=False).encode("utf-8")
    return found


def python(code: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a process of its own."""
    return subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, **environment},
    )
