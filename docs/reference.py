# SPDX-License-Identifier: MIT
"""Write docs/cli.md, the reference of all commands, from the declarations of their options."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer

from salsanext_cli.commands.line.app import COMMANDS, app
from salsanext_cli.commands.line.output.help import by_panel, default_text, synopsis, usage

PAGE = Path(__file__).with_name("cli.md")
PANELS = ("Options", "Selection", "Network", "Running", "Output")
LEAST_SHARED = 3  # Commands with an option that is described once for all
INTRODUCTION = """\
<!-- Made by docs/reference.py. Change the help texts of the commands, not this page. -->

# Commands

`salsanext --help` lists the commands, `salsanext COMMAND --help` the usual options of a command.
If there are others, `salsanext COMMAND --help-all` lists them too. This page lists all of them.
Options that several commands share are described [at the end](#shared-options).
"""
SHARED = """\
## Shared options

A command takes the shared options that its section names.
"""
Row = tuple[str, str, str, str]
"""Panel of the help, what to type, meaning, and default."""


def main() -> None:
    """Write the page."""
    PAGE.write_text(page(), "utf-8")


def page() -> str:
    """Return the whole page."""
    group: Any = typer.main.get_command(app)
    by_section = {
        heading: dict(pair for name in names for pair in members(name, group.commands[name]))
        for heading, names in COMMANDS.items()
    }
    shared = shared_rows([command for of in by_section.values() for command in of.values()])
    lines = [INTRODUCTION]
    for heading, commands in by_section.items():
        lines += [f"## {heading}", ""]
        for name, command in commands.items():
            lines += [*section(name, command, shared), ""]
    lines += [SHARED, *tables(shared)]
    return "\n".join(lines).rstrip() + "\n"


def members(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    """Yield a command and its name, or those of a group."""
    inner = getattr(command, "commands", None)
    if inner is None:
        yield name, command
    else:
        yield from ((f"{name} {member}", command) for member, command in inner.items())


def shared_rows(commands: list[Any]) -> list[Row]:
    """Return the options that several commands have, in the most common form of each name."""
    counts = Counter(row for command in commands for row in rows_of(command))
    usual = {row[1]: row for row, count in counts.most_common()[::-1] if count >= LEAST_SHARED}
    rows = [row for row in counts if usual.get(row[1]) == row and row[0] != "Arguments"]
    return sorted(rows, key=lambda row: PANELS.index(row[0]))


def section(name: str, command: Any, shared: list[Row]) -> Iterator[str]:
    """Yield the lines about one command: description, example, arguments and options."""
    text, _, example = str(command.help).partition("Example:")
    yield f"### salsanext {name}\n\n{' '.join(text.split())}\n"
    yield f"```sh\n{' '.join(example.split())}\n```\n"
    yield f"Usage: `salsanext {name} {usage(command)}`\n"
    rows = rows_of(command)
    yield from tables([row for row in rows if row not in shared])
    if names := [row[1].split("`")[1].split()[0] for row in rows if row in shared]:
        yield f"Shared options: {', '.join(f'`{option}`' for option in names)}"


def rows_of(command: Any) -> list[Row]:
    """Return the rows of the tables of a command."""
    return [row_of(panel, p) for panel, ps in by_panel(command.params).items() for p in ps]


def row_of(panel: str, parameter: Any) -> Row:
    """Return the row of a parameter."""
    text = str(parameter.help)
    text += f" Also `{parameter.envvar}`." if parameter.envvar else ""
    default = "required" if parameter.required else default_text(parameter)
    plain = default and not isinstance(parameter.show_default, str) and not parameter.required
    default = f"`{default}`" if plain else default
    names = synopsis(parameter)
    if parameter.param_type_name == "option":
        *short, name = names.split(", ")
        names = f"{name}`, `{short[0]}" if short else name
    return panel, f"`{names}`", text, default


def tables(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of a table for each panel."""
    for panel in dict.fromkeys(row[0] for row in rows):
        yield f"| {panel} | | default |\n|---|---|---|"
        for _, *cells in (row for row in rows if row[0] == panel):
            yield f"| {' | '.join(in_table(cell) for cell in cells)} |"
        yield ""


def in_table(cell: str) -> str:
    """Return a cell of a table, whose bars are entities, since code shows backslashes."""
    parts = cell.split("`")
    for place, part in enumerate(parts):
        is_code = place % 2 == 1
        if is_code and "|" in part:
            parts[place] = f"<code>{part.replace('|', '&#124;')}</code>"
        else:
            parts[place] = f"`{part}`" if is_code else part.replace("|", "&#124;")
    return "".join(parts)


if __name__ == "__main__":
    main()
