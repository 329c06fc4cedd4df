# SPDX-License-Identifier: MIT
"""Command line: all commands, in the order in which the help lists them."""

import sys
from collections.abc import Callable
from io import TextIOWrapper
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from salsanext_cli.cli.console import WRONG_USE, guarded, usage_errors
from salsanext_cli.cli.convert import convert
from salsanext_cli.cli.demo import demo
from salsanext_cli.cli.evaluate import evaluate
from salsanext_cli.cli.export_onnx import export_onnx
from salsanext_cli.cli.export_ply import export_ply
from salsanext_cli.cli.export_rrd import export_rrd
from salsanext_cli.cli.import_labels import import_labels
from salsanext_cli.cli.import_weights import import_weights
from salsanext_cli.cli.inspect import inspect
from salsanext_cli.cli.knn_refine import knn_refine
from salsanext_cli.cli.models import models
from salsanext_cli.cli.option_groups import expanded
from salsanext_cli.cli.pick import pick
from salsanext_cli.cli.picture import picture
from salsanext_cli.cli.predict import predict
from salsanext_cli.cli.project import project
from salsanext_cli.cli.report import report
from salsanext_cli.cli.submit import submit
from salsanext_cli.cli.synth import synth
from salsanext_cli.cli.train import train
from salsanext_cli.cli.tune import tune
from salsanext_cli.cli.uncertainty import uncertainty
from salsanext_cli.cli.view import view
from salsanext_cli.version import __version__

COMMANDS: dict[str, dict[str, Callable[..., None] | typer.Typer]] = {
    "Pipeline": {
        "project": project,
        "train": train,
        "predict": predict,
        "knn-refine": knn_refine,
        "uncertainty": uncertainty,
        "eval": evaluate,
        "export-ply": export_ply,
    },
    "Your own data": {
        "inspect": inspect,
        "convert": convert,
        "pick": pick,
        "import-labels": import_labels,
        "synth": synth,
        "submit": submit,
    },
    "Models": {
        "models": models,
        "import-weights": import_weights,
        "export-onnx": export_onnx,
        "tune": tune,
    },
    "Look": {
        "picture": picture,
        "export-rrd": export_rrd,
        "demo": demo,
        "report": report,
        "view": view,
    },
}


UNUSED = "scipy.linalg"
"""Module that numba imports if it can: a quarter of a second for what no kernel uses."""


class Sections(TyperGroup):
    """Group that lists the commands above as plain text: importing rich doubles the time."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Write the help, as for wrong usage, if no command is given."""
        if not args and not ctx.resilient_parsing:
            typer.echo(ctx.get_help(), err=True)
            ctx.exit(WRONG_USE)
        with usage_errors(list(args)):
            return super().parse_args(ctx, args)

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
            with formatter.section(title):
                formatter.write_dl(
                    [(name, self.commands[name].get_short_help_str(limit=200)) for name in names]
                )


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
            app.command(name)(guarded(expanded(command)))


def _fails_at_lacking(stream: TextIOWrapper) -> bool:
    """Return whether a character that the encoding lacks would be an error, unasked."""
    # Python sets "strict", or in the C locale "surrogateescape"; anything else, the user has set.
    return stream.errors == "strict" or (
        stream.errors == "surrogateescape" and stream.encoding.lower() != "utf-8"
    )


def main() -> None:
    """Run the command line."""
    sys.modules.setdefault(UNUSED, None)  # type: ignore[arg-type]
    if isinstance(sys.stdout, TextIOWrapper) and _fails_at_lacking(sys.stdout):
        sys.stdout.reconfigure(errors="replace")
    app()
