# SPDX-License-Identifier: MIT
"""`salsanext tune`: a group of commands."""

from collections.abc import Callable

import typer

from salsanext_cli.cli.console import guarded
from salsanext_cli.cli.option_groups import expanded
from salsanext_cli.cli.tune_batchnorm import tune_batchnorm
from salsanext_cli.cli.tune_dropout import tune_dropout
from salsanext_cli.cli.tune_temperature import tune_temperature

COMMANDS: dict[str, Callable[..., None]] = {
    "temperature": tune_temperature,
    "dropout": tune_dropout,
    "batchnorm": tune_batchnorm,
}

tune = typer.Typer(
    no_args_is_help=True,
    help="Fit weights to scans: temperature, dropout rate or batch normalisation.",
)
for name, command in COMMANDS.items():
    tune.command(name)(guarded(expanded(command)))
