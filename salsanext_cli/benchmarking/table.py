# SPDX-License-Identifier: MIT
"""Table of a benchmark."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

ABSENT = "–"


def benchmark_table(found: Mapping[str, Any]) -> Table:
    """Return a table with a row per part of what `benchmark.benchmark` returns."""
    from rich.markup import escape
    from rich.table import Table

    machine, ceiling, settings = found["machine"], found["ceiling"], found["settings"]
    sensor, precision = settings["sensor"], machine["precision"]
    title = (
        f"{machine['processor']} ({machine['instructions']}), {machine['threads']} threads, "
        f"torch {machine['torch_version']}, {machine['device']}\n"
        f"{sensor['name']}, {sensor['height']}×{sensor['width']}, {precision}; "
        f"{settings['scans']} scans of {settings['points']:,} points on average"
    )
    notes = (
        f"Medians of {settings['rounds']} rounds, in brackets the lowest and the highest ratio of "
        "a round; of help, CPU time.\n"
        f"Ceiling: {ceiling['operations'] / 1e9:,.0f} GFLOP/s of a matrix product in {precision}, "
        f"{ceiling['bytes'] / 1e9:,.1f} GB/s of a memory copy.\n"
        f"Of the baseline's {settings['samples']} passes, all alike, {settings['passes']} timed."
    )
    table = Table(title=escape(title), caption=escape(notes))
    table.title_justify = table.caption_justify = "left"
    table.add_column("part", no_wrap=True)
    for heading in ("baseline", "product", "times as fast", "of ceiling", "peak memory, GB"):
        table.add_column(heading, justify="right", no_wrap=True)
    for part in found["parts"]:
        ratio, share = part["ratio"], part["share_of_ceiling"]
        sides = [part[side] for side in ("baseline", "product")]
        peaks = [side["peak_bytes"] for side in sides if side]
        table.add_row(
            part["part"],
            *(_time(side["median"]) if side else ABSENT for side in sides),
            "{median:.3g} × ({lowest:.3g} to {highest:.3g})".format_map(ratio) if ratio else ABSENT,
            f"{share:.1%}" if share else ABSENT,
            " / ".join(f"{peak / 1e9:.2f}" if peak else ABSENT for peak in peaks),
        )
    return table


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s " if seconds >= 1 else f"{seconds * 1e3:.3g} ms"
