# SPDX-License-Identifier: MIT
"""Command line: all commands, in the order in which the help lists them."""

import sys
from collections.abc import Callable
from inspect import signature
from io import TextIOWrapper
from typing import Annotated

import typer

from salsanext_cli.commands.line.commands import (
    compare,
    convert,
    demo,
    evaluate,
    export_bag,
    export_las,
    export_onnx,
    export_ply,
    filter,
    fuse,
    import_labels,
    import_weights,
    inspect,
    knn_refine,
    models,
    pick,
    picture,
    predict,
    project,
    report,
    submit,
    synth,
    uncertainty,
    view,
)
from salsanext_cli.commands.line.commands.train import train
from salsanext_cli.commands.line.commands.tune import tune
from salsanext_cli.commands.line.options.expansion import expanded
from salsanext_cli.commands.line.output.console import guarded
from salsanext_cli.commands.line.output.help import Command, Group
from salsanext_cli.core.errors import UsageError
from salsanext_cli.version import __version__

COMMANDS: dict[str, dict[str, Callable[..., None] | typer.Typer]] = {
    "Start": {
        "demo": demo.demo,
        "predict": predict.predict,
        "report": report.report,
        "view": view.view,
        "inspect": inspect.inspect,
    },
    "Improve": {
        "fuse": fuse.fuse,
        "pick": pick.pick,
        "import-labels": import_labels.import_labels,
        "train": train,
    },
    "Trust": {
        "eval": evaluate.evaluate,
        "compare": compare.compare,
        "uncertainty": uncertainty.uncertainty,
        "tune": tune,
    },
    "Data": {
        "convert": convert.convert,
        "export-ply": export_ply.export_ply,
        "export-bag": export_bag.export_bag,
        "export-las": export_las.export_las,
        "picture": picture.picture,
        "filter": filter.filter_command,
        "synth": synth.synth,
        "submit": submit.submit,
    },
    "Advanced": {
        "project": project.project,
        "knn-refine": knn_refine.knn_refine,
        "models": models.models,
        "import-weights": import_weights.import_weights,
        "export-onnx": export_onnx.export_onnx,
    },
}


class Sections(Group):
    """Group of all commands."""

    sections = {section: [*commands] for section, commands in COMMANDS.items()}  # noqa: RUF012


app = typer.Typer(
    name="salsanext",
    cls=Sections,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)


@app.callback(invoke_without_command=True)
@guarded
def salsanext(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", "-V", help="Print the version; see --verbose.")
    ] = False,
    verbose: Annotated[
        bool,
        typer.Option("--verbose", help="With --version: also packages, device, CPU and extras."),
    ] = False,
) -> None:
    """Predict a class and an uncertainty for every point of a LiDAR scan."""
    if version:
        from salsanext_cli.commands.line.output.version_report import version_lines

        typer.echo("\n".join(version_lines()) if verbose else f"salsanext {__version__}")
        raise typer.Exit
    if verbose:
        hint = "put it after the command, or add --version"
        raise UsageError("--verbose", "is given before the command", hint=hint)
    if context.invoked_subcommand is None:
        raise UsageError("salsanext", "no command", hint="run `salsanext --help`")


for commands in COMMANDS.values():
    for name, command in commands.items():
        if isinstance(command, typer.Typer):
            app.add_typer(command, name=name)
        else:
            # All but the first of several sources are no parameters.
            settings = {"allow_extra_args": "context" in signature(command).parameters}
            app.command(name, cls=Command, context_settings=settings)(guarded(expanded(command)))


def main() -> None:
    """Run the command line."""
    if isinstance(sys.stdout, TextIOWrapper):
        # By Python's default, strict and in the C locale surrogateescape, a character outside the
        # encoding is an error. The user may have set something else.
        errors = sys.stdout.errors
        is_utf8 = sys.stdout.encoding.lower() == "utf-8"
        if errors == "strict" or (errors == "surrogateescape" and not is_utf8):
            sys.stdout.reconfigure(errors="replace")
    app()
