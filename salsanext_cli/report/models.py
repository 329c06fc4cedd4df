# SPDX-License-Identifier: MIT
"""Tables of networks and of weights files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table


def network_table(networks: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of networks and what they cost."""
    from rich.table import Table

    table = Table(title="Networks", title_justify="left")
    table.add_column("name")
    table.add_column("parameters", justify="right")
    table.add_column("multiply-accumulates at 64×2048", justify="right")
    for network in networks:
        macs = f"{network['multiply_accumulates'] / 1e9:.2f} G"
        table.add_row(network["name"], f"{network['parameters']:,}", macs)
    return table


def card_table(card: Mapping[str, Any]) -> Table:
    """Return a table of what a weights file says of itself."""
    from rich.markup import escape
    from rich.table import Table

    sensor = card["sensor"]
    table = Table(title=escape(card["path"]), title_justify="left", show_header=False)
    table.add_row("what", escape(card["description"]) or "–")
    table.add_row("architecture", ", ".join(f"{k} {v}" for k, v in card["architecture"].items()))
    table.add_row("temperature", f"{card['temperature']:.4g}")
    table.add_row("label space", escape(f"{card['label_space']}, {len(card['classes'])} classes"))
    view = f"{sensor['fov_up']:+g}° to {sensor['fov_down']:+g}°"
    table.add_row(
        "sensor", escape(f"{sensor['name']}, {sensor['height']}×{sensor['width']}, {view}")
    )
    table.add_row("scores of the scans that chose the weights", _scores(card["scores"]) or "–")
    table.add_row("size", f"{card['bytes'] / 1e6:.1f} MB")
    table.add_row("SHA-256", card["sha256"])
    return table


def _scores(scores: Mapping[str, Any]) -> str:
    """Return names and numbers, rounded: the digits beyond are those of a few scans."""
    from rich.markup import escape

    numbers = {name: f"{v:.3f}" if isinstance(v, float) else v for name, v in scores.items()}
    return escape(", ".join(f"{name} {number}" for name, number in numbers.items()))
