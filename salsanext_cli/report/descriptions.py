# SPDX-License-Identifier: MIT
"""Tables that describe networks, weights files and sets of scans."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.console import Group
from rich.markup import escape
from rich.table import Table

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import printable
from salsanext_cli.measures.survey import Survey
from salsanext_cli.records import CHANNELS
from salsanext_cli.report.tables import number_table
from salsanext_cli.sensors.sensor import Sensor

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
    table.caption = "\n".join(NOTES.values())
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
    if card["error"] is not None:
        table.add_row("model of errors, on scans left out", _scores(card["error"]) or "–")
    if card["trained_on"]:
        table.add_row("scans known from training", f"{card['trained_on']:,}")
    table.add_row("size", f"{card['bytes'] / 1e6:.1f} MB")
    table.add_row("SHA-256", card["sha256"])
    return table


def _scores(scores: Mapping[str, Any]) -> str:
    """Return names and rounded numbers; further digits depend on a few scans."""
    return escape(", ".join(f"{name} {_rounded(value)}" for name, value in scores.items()))


def _rounded(value: Any) -> str:
    """Return a score as text; of several, each with its name or without."""
    if isinstance(value, Mapping):
        return f"({', '.join(f'{name} {_rounded(each)}' for name, each in value.items())})"
    if isinstance(value, list):
        return " ".join(map(str, value))
    return f"{value:.3f}" if isinstance(value, float) else str(value)


def survey_tables(
    sequences: Mapping[str, Survey], total: Survey, space: LabelSpace, sensor: Sensor
) -> Group:
    """Return tables of the sequences, of the channels and, if there are labels, of the classes."""
    tables = [_sequences(sequences, total), _channels(total, sensor)]
    if total.classes:
        tables.append(_classes(total, space))
    return Group(*tables)


def _sequences(sequences: Mapping[str, Survey], total: Survey) -> Table:
    numbers = ("scans", "labelled", "points per scan", "invalid points", "farthest, m", "brightest")
    table = number_table("sequence", *numbers, "field of view", title="Scans")
    rows = dict(sequences) | ({"all": total} if len(sequences) > 1 else {})
    for name, found in rows.items():
        up, down = found.field_of_view()
        table.add_row(
            escape(printable(name)),
            f"{found.scans:,}",
            f"{found.labelled:,}",
            f"{min(found.smallest, found.largest):,} – {found.largest:,}",
            f"{found.invalid:,}",
            f"{found.farthest:.1f}",
            f"{found.brightest:.3g}",
            f"{up:+.2f}° to {down:+.2f}°",
        )
    return table


def _channels(total: Survey, sensor: Sensor) -> Table:
    title = f"Range images of {sensor.name}, {sensor.height}×{sensor.width}"
    table = number_table("channel", "mean", "standard deviation", title=title)
    for name, mean, std in zip(CHANNELS, total.means, total.stds, strict=True):
        table.add_row(name, f"{mean:.3f}", f"{std:.3f}")
    return table


def _classes(total: Survey, space: LabelSpace) -> Table:
    numbers = ("train id and class", "points", "share %")
    table = number_table("raw id and name", *numbers, title="Classes")
    points = sum(total.classes.values())
    for raw, count in sorted(total.classes.items()):
        train = space.learning_map.get(raw)
        table.add_row(
            escape(f"{raw} {space.labels.get(raw, 'unknown')}"),
            "unknown" if train is None else escape(f"{train} {space.names[train]}"),
            f"{count:,}",
            f"{100 * count / points:.3f}",
        )
    return table
