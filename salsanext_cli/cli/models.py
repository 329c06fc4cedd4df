# SPDX-License-Identifier: MIT
"""`salsanext models`."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from salsanext_cli.cli import console, options

if TYPE_CHECKING:
    from rich.table import Table

    from salsanext_cli.stages.models import Model


@console.guarded
def models(
    weights: Annotated[
        list[Path] | None,
        typer.Argument(help="Weights files to describe.", show_default="the default weights"),
    ] = None,
    json: options.Json = False,
    verbose: options.Verbose = False,
    quiet: options.Quiet = False,
) -> None:
    """List the networks and what they cost; say what weights files are.

    Example: salsanext models runs/street/best.safetensors
    """
    from rich.console import Group

    from salsanext_cli.network.weights import default_weights
    from salsanext_cli.stages.models import describe_weights
    from salsanext_cli.stages.models import models as count

    talk = console.Talk(json, verbose, quiet)
    found = count()
    described = [describe_weights(path) for path in weights or [default_weights()]]
    listed = [
        {"name": m.name, "parameters": m.parameters, "multiply_accumulates": m.multiply_accumulates}
        for m in found
    ]
    tables = Group(_networks(found), *(_card(card) for card in described))
    talk.result({"models": listed, "weights": described}, tables)


def _networks(found: "list[Model]") -> "Table":
    from rich.table import Table

    table = Table(title="Networks", title_justify="left")
    table.add_column("name")
    table.add_column("parameters", justify="right")
    table.add_column("multiply-accumulates at 64×2048", justify="right")
    for model in found:
        macs = f"{model.multiply_accumulates / 1e9:.2f} G"
        table.add_row(model.name, f"{model.parameters:,}", macs)
    return table


def _card(card: Mapping[str, Any]) -> "Table":
    from rich.table import Table

    sensor = card["sensor"]
    table = Table(title=card["path"], title_justify="left", show_header=False)
    table.add_row("what", card["description"] or "–")
    table.add_row("architecture", ", ".join(f"{k} {v}" for k, v in card["architecture"].items()))
    table.add_row("label space", f"{card['label_space']}, {len(card['classes'])} classes")
    view = f"{sensor['fov_up']:+g}° to {sensor['fov_down']:+g}°"
    table.add_row("sensor", f"{sensor['name']}, {sensor['height']}×{sensor['width']}, {view}")
    table.add_row("scores", ", ".join(f"{k} {v}" for k, v in card["scores"].items()) or "–")
    table.add_row("size", f"{card['bytes'] / 1e6:.1f} MB")
    table.add_row("SHA-256", card["sha256"])
    return table
