# SPDX-License-Identifier: MIT
"""Commands and groups whose help is plain text, since importing rich doubles the time."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import typer

from salsanext_cli.commands.line.options.options_file import settle_options, use_options_file
from salsanext_cli.commands.line.options.removed import refuse_removed
from salsanext_cli.commands.line.options.typer_interface import (
    TyperCommand,
    TyperGroup,
    stating_command,
)
from salsanext_cli.commands.line.output.console import WRONG_USE, usage_errors
from salsanext_cli.commands.line.values.cluster_option import choose_workers

DOCUMENTATION = "https://salsanext.readthedocs.io"
NAMES_WIDTH = 24  # Columns of the names of options; longer ones get a line
HIDDEN = {
    "": "--batch --cluster --dry-run --ego --engine --events --install-completion --intensity "
    "--knn-cutoff --knn-k --knn-sigma --knn-window --min-range --movable-reach --on-error --origin "
    "--pixel-labels --precision --shard --show-completion",
    "pick": "--seed",
    **dict.fromkeys(("export-las", "export-ply", "picture", "report", "view"), "--label-space"),
}
"""Options that only `--help-all` lists, by command, "" for all commands."""
HELP = ("-h, --help", "Show this message.")
HELP_ALL = ("--help-all", "Show all options.")


def write_help(command: Any, ctx: Any, formatter: Any, *, every: bool = False) -> None:
    """Write usage, description, link, commands and options.

    `every`: whether to write the hidden options too.
    """
    formatter.write_usage(ctx.command_path, usage(command))
    command.format_help_text(ctx, formatter)
    if hasattr(command, "commands"):
        formatter.write_paragraph()
    _write_link(ctx, formatter)
    if hasattr(command, "commands"):
        _write_commands(command, formatter)
    _write_options(command, ctx, formatter, every=every)


def _write_link(ctx: Any, formatter: Any) -> None:
    """Write the address of the documentation, for a command that of its section."""
    anchor = ""
    if ctx.parent:
        anchor = f"/cli/#{'-'.join(['salsanext', *_names(ctx)])}"
    with formatter.indentation():
        formatter.write_text(f"Docs: {DOCUMENTATION}{anchor}")


def _write_commands(group: Any, formatter: Any) -> None:
    """Write the commands of a group with their short help, by section."""
    sections = group.sections or {"Commands": list(group.commands)}
    for heading, names in sections.items():
        rows = [(name, group.commands[name].get_short_help_str(200)) for name in names]
        if rows:
            with formatter.section(heading):
                formatter.write_dl(rows)


def _write_options(command: Any, ctx: Any, formatter: Any, *, every: bool) -> None:
    """Write arguments and options by panel; `every`: the hidden ones too.

    A command without hidden options does not offer `--help-all`, which would show the same.
    """
    hidden = _hidden(command, ctx)
    panels: dict[str, list[tuple[str, str]]] = {}
    for heading, parameters in by_panel(command.params).items():
        listed = [p for p in parameters if every or not hidden.intersection(p.opts)]
        panels[heading] = [(synopsis(parameter), _meaning(parameter)) for parameter in listed]
    if not panels:
        panels["Options"] = []
    last_panel = list(panels.values())[-1]
    last_panel.append(HELP)
    if hidden:
        last_panel.append(HELP_ALL)
    for heading, rows in panels.items():
        if rows:
            with formatter.section(heading):
                formatter.write_dl(rows, col_max=NAMES_WIDTH)


class Command(TyperCommand):
    """Command that refuses removed options, and whose `--help-all` lists the hidden ones."""

    format_help = write_help

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line, or print the whole help."""
        if ctx.resilient_parsing:
            return super().parse_args(ctx, args)
        is_json = "--json" in args
        refuse_removed(_names(ctx), args, json=is_json)
        _print_whole_help(self, ctx, args)
        use_options_file(ctx, args, json=is_json)
        with stating_command(ctx):
            others = super().parse_args(ctx, args)
        settle_options(ctx)
        choose_workers(ctx, json=is_json)
        return others


class Group(TyperGroup):
    """Group of commands in sections."""

    sections: ClassVar[Mapping[str, Sequence[str]]] = {}
    format_help = write_help

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the command line, or print the help; without a command, as for wrong usage."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(WRONG_USE)
        if args[:1] == ["--help-all"]:
            _print_whole_help(self, ctx, args)
        with usage_errors(args), stating_command(ctx):
            return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the command, unless it was removed."""
        refuse_removed(args[:1], [], json="--json" in args)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with usage_errors(ctx.args):
            return super().invoke(ctx)


def _names(ctx: Any) -> list[str]:
    """Return the name of a command after those of its groups, without that of the program."""
    return [*_names(ctx.parent), ctx.info_name] if ctx.parent else []


def _hidden(command: Any, ctx: Any) -> set[str]:
    """Return the options of a command that only the whole help lists."""
    listed = " ".join(HIDDEN.get(name, "") for name in ("", *_names(ctx))).split()
    offered = {name for parameter in command.params for name in parameter.opts}
    return offered.intersection(listed)


def _print_whole_help(command: Any, ctx: Any, args: Sequence[str]) -> None:
    if "--help-all" in args:
        formatter = ctx.make_formatter()
        write_help(command, ctx, formatter, every=True)
        typer.echo(formatter.getvalue(), nl=False)
        ctx.exit()


def usage(command: Any) -> str:
    """Return what follows the name of a command; brackets mark what is optional."""
    words = ["[OPTIONS]"]
    for parameter in command.params:
        if parameter.param_type_name == "argument":
            name = synopsis(parameter)
            words.append(name if parameter.required else f"[{name}]")
    if hasattr(command, "commands"):
        words.append("COMMAND")
    return " ".join(words)


def by_panel(parameters: Sequence[Any]) -> dict[str, list[Any]]:
    """Return arguments and options by the heading of their panel."""
    panels: dict[str, list[Any]] = {"Arguments": [], "Options": []}
    for parameter in parameters:
        panel = parameter.rich_help_panel or f"{parameter.param_type_name.title()}s"
        panels.setdefault(panel, []).append(parameter)
    return {heading: members for heading, members in panels.items() if members}


def synopsis(parameter: Any) -> str:
    """Return what to type for a parameter."""
    if parameter.param_type_name == "argument":
        return str(parameter.metavar)
    names = ", ".join(sorted(parameter.opts, key=len))
    return names if parameter.is_flag else f"{names} {parameter.metavar}"


def default_text(parameter: Any) -> str:
    """Return the value of a parameter that is not given; nothing if it is empty or off."""
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    is_empty = parameter.default is None or parameter.default is False or parameter.default == ""
    return "" if is_empty or parameter.required else str(parameter.default)


def _meaning(parameter: Any) -> str:
    """Return the help of a parameter, with notes about its variable and its default."""
    notes: list[str] = []
    if parameter.required:
        notes.append("required")
    if parameter.envvar:
        notes.append(f"env: {parameter.envvar}")
    default = default_text(parameter)
    if default:
        notes.append(f"default: {default}")
    return f"{parameter.help} [{'; '.join(notes)}]" if notes else str(parameter.help)
