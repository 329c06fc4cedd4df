# SPDX-License-Identifier: MIT
"""Results of tuning: tables, and the curve of the dropout rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import TYPE_CHECKING, Any

from salsanext_cli.report import canvas
from salsanext_cli.report.canvas import DARK
from salsanext_cli.report.tables import number_table

if TYPE_CHECKING:
    from rich.table import Table

BEST_COLOUR = "#b3472f"


def temperature_table(before: Mapping[str, float], after: Mapping[str, float]) -> Table:
    """Return a table of `temperature`, `nll` in nats and `ece` as a share, before and after."""
    table = number_table("", "temperature", "NLL in nats", "ECE in %", title="Temperature")
    for name, found in (("before", before), ("after", after)):
        cells = (f"{found['temperature']:.4f}", f"{found['nll']:.4f}", f"{100 * found['ece']:.2f}")
        table.add_row(name, *cells)
    return table


def rate_table(rates: Sequence[float], objectives: Sequence[float], best: float) -> Table:
    """Return a table of dropout rates and their objectives, the best one marked."""
    table = number_table("rate", "objective per point", title="Dropout rate")
    table.columns[0].justify = "right"
    table.add_column("")
    for rate, objective in zip(rates, objectives, strict=True):
        table.add_row(f"{rate:.4f}", f"{objective:.4f}", "best" if rate == best else "")
    return table


def moved_table(layers: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table of how far batch norms moved, by the part of the network that they are in.

    Parameters
    ----------
    layers : sequence of mapping
        `layer`, its name, `shift` in old standard deviations, and `variance_ratio`.
    """
    numbers = ("layers", "mean moved by, σ", "variance, new / old")
    table = number_table("part", *numbers, title="Batch norm")
    for part, members in groupby(layers, lambda layer: layer["layer"].partition(".")[0]):
        _add_moved(table, part, list(members))
    table.add_section()
    _add_moved(table, "all", layers)
    return table


def _add_moved(table: Table, part: str, layers: Sequence[Mapping[str, Any]]) -> None:
    shift = fmean(layer["shift"] for layer in layers)
    ratio = geometric_mean(layer["variance_ratio"] for layer in layers)
    table.add_row(part, str(len(layers)), f"{shift:.3f}", f"{ratio:.3f}")


def rate_curve(
    path: Path, rates: Sequence[float], objectives: Sequence[float], best: float
) -> None:
    """Draw the objective over the dropout rate, logarithmic, the best rate marked, as a PNG."""
    title = f"least at a dropout rate of {best:.3g}"
    figure, axes = canvas.new_plot(760, 460, (90, 50, 640, 340), title)
    axes.plot(rates, objectives, color=DARK, marker="o", markersize=5, linewidth=1.2)
    axes.axvline(best, color=BEST_COLOUR, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_xscale("log")
    axes.set_xticks(rates, [f"{rate:.2g}" for rate in rates])
    axes.minorticks_off()
    axes.set_xlabel("dropout rate")
    axes.set_ylabel("objective per point")
    canvas.plain_frame(axes)
    canvas.save_png(figure, path)
