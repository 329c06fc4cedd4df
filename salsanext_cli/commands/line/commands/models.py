# SPDX-License-Identifier: MIT
"""`salsanext models`."""

from pathlib import Path

from salsanext_cli.commands.line.options.option_fields import argument
from salsanext_cli.commands.line.output import console
from salsanext_cli.runs.network_settings import DEFAULT_WEIGHTS, weights_file


def models(
    weights: list[Path] | None = argument(
        "Weights files to describe.",
        metavar="WEIGHTS...",
        show_default="the weights of the package",
    ),
    *,
    output: console.Output,
) -> None:
    """Describe weights; list networks and plug-ins.

    Example: salsanext models runs/street/best.safetensors
    """
    from rich.console import Group, RenderableType
    from rich.text import Text

    from salsanext_cli.commands.stages.models import describe_weights, plug_ins
    from salsanext_cli.core.network.registry import ARCHITECTURES, plugged_networks
    from salsanext_cli.core.network.weights_names import PAPER_NETWORKS
    from salsanext_cli.core.optional_packages import extra_command
    from salsanext_cli.report.card_table import card_table
    from salsanext_cli.report.tables import table_of

    networks = [*ARCHITECTURES, *plugged_networks()]
    installed = plug_ins()
    described = [describe_weights(weights_file(path)) for path in weights or [DEFAULT_WEIGHTS]]
    tables: list[RenderableType] = [card_table(card) for card in described]
    if installed:
        headings = list(installed[0])
        rows = [list(plug_in.values()) for plug_in in installed]
        tables.append(table_of(headings, rows, texts=headings, title="Plug-ins"))
    tables.append(Text(f"networks: {', '.join(networks)}"))
    if not any(name.startswith(PAPER_NETWORKS) for name in networks):
        tables.append(Text(f"networks of the papers: {extra_command('paper')}"))
    result = {"stage": "models", "models": networks, "plug_ins": installed, "weights": described}
    output.result(result, Group(*tables))
