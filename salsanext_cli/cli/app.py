# SPDX-License-Identifier: MIT
"""Command line: all commands, in the order in which the help lists them."""

import sys
from collections.abc import Callable
from inspect import signature
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from salsanext_cli.cli import look, models, own_data, pipeline, results
from salsanext_cli.cli.console import WRONG_USE, guarded, usage_errors
from salsanext_cli.cli.expansion import expanded
from salsanext_cli.cli.removed import refuse_removed, refuse_removed_command
from salsanext_cli.cli.train import train
from salsanext_cli.cli.tune import tune
from salsanext_cli.version import __version__

COMMANDS: dict[str, dict[str, Callable[..., None] | typer.Typer]] = {
    "Pipeline": {
        "project": pipeline.project,
        "train": train,
        "predict": pipeline.predict,
        "knn-refine": pipeline.knn_refine,
        "fuse": results.fuse,
        "uncertainty": pipeline.uncertainty,
        "eval": results.evaluate,
        "compare": results.compare,
        "export-ply": results.export_ply,
    },
    "Your own data": {
        "inspect": own_data.inspect,
        "convert": own_data.convert,
        "pick": own_data.pick,
        "import-labels": own_data.import_labels,
        "filter": results.filter_command,
        "synth": own_data.synth,
        "submit": own_data.submit,
    },
    "Models": {
        "models": models.models,
        "import-weights": models.import_weights,
        "export-onnx": models.export_onnx,
        "tune": tune,
    },
    "Look": {
        "picture": look.picture,
        "demo": look.demo,
        "report": look.report,
        "view": look.view,
    },
}


class Command(TyperCommand):
    """Command that names what replaces a removed option, and whose help flag shows no type."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Refuse removed options, then parse."""
        if not ctx.resilient_parsing:
            refuse_removed(ctx.info_name, args, json="--json" in args)
        return super().parse_args(ctx, args)

    def get_help_option(self, ctx: Any) -> Any:
        """Return the option of the help."""
        option = super().get_help_option(ctx)
        if option is not None:
            option.metavar = ""
        return option


class Sections(TyperGroup):
    """Group that lists the commands above as plain text: importing rich doubles the time."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Write the help, as for wrong usage, if no command is given."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(WRONG_USE)
        with usage_errors(list(args)):
            return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Refuse removed commands, then find the command."""
        refuse_removed_command(args[0], json="--json" in args)
        return super().resolve_command(ctx, args)

    def invoke(self, ctx: Any) -> Any:
        """Run the command."""
        with usage_errors(list(ctx.args)):
            return super().invoke(ctx)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Write usage, description, options and commands."""
        self.format_usage(ctx, formatter)
        self.format_help_text(ctx, formatter)
        self.format_options(ctx, formatter)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands of each section with the first sentence of their help."""
        for title, names in COMMANDS.items():
            helps = [(name, self.commands[name].get_short_help_str(limit=200)) for name in names]
            with formatter.section(title):
                formatter.write_dl(helps)


app = typer.Typer(
    name="salsanext",
    cls=Sections,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"salsanext {__version__}")
        raise typer.Exit


@app.callback()
def salsanext(
    version: Annotated[
        bool,
        typer.Option(
            "--version", "-V", callback=_print_version, is_eager=True, help="Print the version."
        ),
    ] = False,
) -> None:
    """Predict a class and an uncertainty for every point of a LiDAR scan."""


for commands in COMMANDS.values():
    for name, command in commands.items():
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            # The further ones of several sources are no parameters.
            several = {"allow_extra_args": "context" in signature(command).parameters}
            app.command(name, cls=Command, context_settings=several)(guarded(expanded(command)))


def main() -> None:
    """Run the command line."""
    if isinstance(sys.stdout, TextIOWrapper):
        # A character that the encoding lacks would be an error by Python's own choice, the second
        # one that of the C locale. Anything else, the user has set.
        how = sys.stdout.errors
        if how == "strict" or (how == "surrogateescape" and sys.stdout.encoding.lower() != "utf-8"):
            sys.stdout.reconfigure(errors="replace")
    app()
