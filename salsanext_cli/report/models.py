# SPDX-License-Identifier: MIT
"""Tables of networks and of weights files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from salsanext_cli.report.tables import number_table

if TYPE_CHECKING:
    from rich.table import Table

NOTES = {
    "agrees": "* not the paper's number of parameters to the digit",
    "determined": "† the paper does not determine this network: the nearest reading",
}
"""Footnotes; networks for which the key is false get the mark."""


def network_table(networks: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of the costs of networks, with the papers' figures in brackets."""
    costs = ("parameters", "multiply-accumulates at 64×2048 (FLOPs)", "receptive field")
    headings = ("name", *costs, "mIoU without kNN, with, on test")
    title = "Networks, with the papers' figures in brackets"
    table = number_table(*headings, title=title, no_wrap=True)
    table.caption, table.caption_justify = "\n".join(NOTES.values()), "left"
    for network in networks:
        table.add_row(*_cells(network))
    return table


def _cells(network: Mapping[str, Any]) -> tuple[str, ...]:
    paper = network["paper"]
    marks = ("" if network["agrees"] else "*") + ("" if paper["determined"] else "†")
    height, width = network["receptive_field"]
    flops = f"({paper['flops']} G)" if paper["flops"] else "(–)"
    return (
        network["name"] + marks,
        f"{network['parameters']:,} ({paper['parameters']} M)",
        f"{network['multiply_accumulates'] / 1e9:.2f} G {flops:>10}",
        f"{height}×{width}",
        ", ".join(f"{paper[key] or '–':>4}" for key in ("miou_pixels", "miou", "miou_test")),
    )


def card_table(card: Mapping[str, Any]) -> Table:
    """Return a table of the card of a weights file."""
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
    """Return names and rounded numbers; further digits depend on a few scans."""
    from rich.markup import escape

    numbers = {name: f"{v:.3f}" if isinstance(v, float) else v for name, v in scores.items()}
    return escape(", ".join(f"{name} {number}" for name, number in numbers.items()))
