# SPDX-License-Identifier: MIT
"""`salsanext tune`: a group, since what is tuned differs in all but its place in the help."""

from collections.abc import Callable

import typer

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
    help="Fit weights to scans: honest probabilities and uncertainties, another sensor or place.",
)
for name, command in COMMANDS.items():
    tune.command(name)(command)
