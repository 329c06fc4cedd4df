# SPDX-License-Identifier: MIT
"""What tuning gave: tables, and the curve of the dropout rates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from statistics import fmean, geometric_mean
from typing import TYPE_CHECKING, Any

from salsanext_cli.report import canvas

if TYPE_CHECKING:
    from rich.table import Table

DARK = "#22262c"
PALE = "#c9ced6"
BEST = "#b3472f"


def temperature_table(before: Mapping[str, float], after: Mapping[str, float]) -> Table:
    """Return a table of `temperature`, `nll` in nats and `ece` as a share, before and after."""
    from rich.table import Table

    table = Table(title="Temperature", title_justify="left")
    table.add_column("")
    for column in ("temperature", "NLL in nats", "ECE in %"):
        table.add_column(column, justify="right")
    for name, found in (("before", before), ("after", after)):
        cells = (f"{found['temperature']:.4f}", f"{found['nll']:.4f}", f"{100 * found['ece']:.2f}")
        table.add_row(name, *cells)
    return table


def rate_table(rates: Sequence[float], objectives: Sequence[float], best: float) -> Table:
    """Return a table of dropout rates and their objectives, the best one marked."""
    from rich.table import Table

    table = Table(title="Dropout rate", title_justify="left")
    table.add_column("rate", justify="right")
    table.add_column("objective per point", justify="right")
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
    from rich.table import Table

    table = Table(title="Batch norm", title_justify="left")
    table.add_column("part")
    for column in ("layers", "mean moved by, σ", "variance, new / old"):
        table.add_column(column, justify="right")
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
    figure = canvas.new_figure(760, 460, canvas.PAPER)
    axes = canvas.axes_at(figure, 90, 50, 640, 340)
    axes.plot(rates, objectives, color=DARK, marker="o", markersize=5, linewidth=1.2)
    axes.axvline(best, color=BEST, linewidth=1, linestyle=(0, (4, 3)))
    axes.set_xscale("log")
    axes.set_xticks(rates, [f"{rate:.2g}" for rate in rates])
    axes.minorticks_off()
    axes.set_xlabel("dropout rate")
    axes.set_ylabel("objective per point")
    axes.grid(color=PALE, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(length=0, colors=DARK, labelsize=10)
    for side in axes.spines.values():
        side.set_visible(False)
    canvas.text_at(figure, 90, 25, f"least at a dropout rate of {best:.3g}", 17, DARK)
    canvas.save_png(figure, path)
