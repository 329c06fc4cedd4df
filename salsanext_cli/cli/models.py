# SPDX-License-Identifier: MIT
"""`salsanext models`."""

from pathlib import Path
from typing import Annotated

import typer

from salsanext_cli.cli import console, options


def models(
    weights: Annotated[
        list[Path] | None,
        typer.Argument(help="Weights files to describe.", show_default="default"),
    ] = None,
    *,
    output: console.Output,
) -> None:
    """List the networks with their cost and the papers' figures; describe weights files.

    Example: salsanext models runs/street/best.safetensors
    """
    from rich.console import Group

    from salsanext_cli.report.tables import card_table, network_table
    from salsanext_cli.stages.models import describe_weights
    from salsanext_cli.stages.models import models as stage

    listed = stage()
    described = [
        describe_weights(options.weights_file(path))
        for path in weights or [options.DEFAULT_WEIGHTS]
    ]
    cards = map(card_table, described)
    networks = network_table(listed)
    tables = Group(*cards, networks) if weights else Group(networks, *cards)
    output.result({"stage": "models", "models": listed, "weights": described}, tables)
