# SPDX-License-Identifier: MIT
"""Write docs/cli.md, the reference of all commands, from what the commands say of themselves.

The text comes from the same declarations as `--help`, not from its printout, so that neither the
width nor the colours of a terminal change it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from salsanext_cli.cli.app import COMMANDS, app

PAGE = Path(__file__).with_name("cli.md")
OWN = "Options"
"""Heading of the options that only this command has."""
INTRODUCTION = """\
<!-- Made by docs/reference.py. Change the help texts of the commands, not this page. -->

# Commands

`salsanext --help` lists the commands, `salsanext COMMAND --help` says what is on this page. What
all commands have in common, such as the exit status, is on the page
[Data and results](reference/files.md).
"""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), "utf-8")


def page() -> str:
    """Return the whole page."""
    group: Any = typer.main.get_command(app)
    lines = [INTRODUCTION]
    for panel, names in COMMANDS.items():
        lines += [f"## {panel}", ""]
        for name in names:
            for full_name, command in members(name, group.commands[name]):
                lines += [*section(full_name, command), ""]
    return "\n".join(lines).rstrip() + "\n"


def members(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """Yield a command and its name, or those of a group."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield name, command
    else:
        yield from ((f"{name} {member}", each) for member, each in inner.items())


def section(name: str, command: Any) -> Iterator[str]:
    """Yield the lines about one command: what it does, an example, its arguments and options."""
    what, _, example = str(command.help).partition("Example:")
    arguments = [p for p in command.params if not p.opts[0].startswith("-")]
    yield f"### salsanext {name}"
    yield ""
    yield " ".join(what.split())
    yield ""
    yield "```sh"
    yield " ".join(example.split())
    yield "```"
    yield ""
    yield " ".join(["Usage: `salsanext", name, *map(placeholder, arguments), "[OPTIONS]`"])
    panels: dict[str, list[Any]] = {"Arguments": arguments, OWN: []}
    for parameter in command.params:
        if parameter not in arguments:
            panels.setdefault(parameter.rich_help_panel or OWN, []).append(parameter)
    for panel, parameters in panels.items():
        if parameters:
            yield ""
            yield from table(panel, parameters)


def table(panel: str, parameters: list[Any]) -> Iterator[str]:
    """Yield the lines of the table of one panel."""
    yield f"| {panel} | | default |"
    yield "|---|---|---|"
    for parameter in parameters:
        cells = (names(parameter), meaning(parameter), default(parameter))
        yield f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def placeholder(argument: Any) -> str:
    """Return how the usage line shows an argument: in brackets if it may be left out."""
    name = word(argument) + ("..." if argument.nargs == -1 else "")
    return name if argument.required else f"[{name}]"


def word(argument: Any) -> str:
    """Return the word that stands for an argument."""
    return str(argument.metavar or argument.name.upper())


def names(parameter: Any) -> str:
    """Return what to type for a parameter."""
    if not parameter.opts[0].startswith("-"):
        return f"`{word(parameter)}`"
    return ", ".join(f"`{option}`" for option in (*parameter.opts, *parameter.secondary_opts))


def meaning(parameter: Any) -> str:
    """Return what a parameter is for, and the variable of the environment that sets it."""
    text = str(parameter.help)
    return f"{text} Also `{parameter.envvar}`." if parameter.envvar else text


def default(parameter: Any) -> str:
    """Return what holds when a parameter is left out; nothing for what is off by default."""
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    if parameter.required:
        return "required"
    return "" if parameter.default in (None, False, "") else f"`{parameter.default}`"


if __name__ == "__main__":
    main()
