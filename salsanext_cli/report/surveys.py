# SPDX-License-Identifier: MIT
"""Tables of the survey of a set of scans."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import printable
from salsanext_cli.measures.survey import Survey
from salsanext_cli.records import CHANNELS
from salsanext_cli.report.tables import number_table
from salsanext_cli.sensors import Sensor

if TYPE_CHECKING:
    from rich.console import Group
    from rich.table import Table


def survey_tables(
    sequences: Mapping[str, Survey], total: Survey, space: LabelSpace, sensor: Sensor
) -> Group:
    """Return tables of the sequences, of the channels and, if there are labels, of the classes."""
    from rich.console import Group

    tables = [_sequences(sequences, total), _channels(total, sensor)]
    if total.classes:
        tables.append(_classes(total, space))
    return Group(*tables)


def _sequences(sequences: Mapping[str, Survey], total: Survey) -> Table:
    from rich.markup import escape

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
    from rich.markup import escape

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
