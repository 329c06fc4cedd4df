# SPDX-License-Identifier: MIT
"""Tables of what a benchmark found."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from rich.table import Table

MEANING = {
    "projection": "projection",
    "network": "network",
    "knn": "kNN",
    "predict": "predict, file to file",
    "uncertainty": "uncertainty, {samples} passes",
    "confusion": "counting for eval",
    "cold": "one scan, cold process",
    "help": "salsanext --help",
}
"""What the rows are."""
NOTHING = "–"


def benchmark_table(found: Mapping[str, Any]) -> Table:
    """Return a table of parts: both sides, the ratio, the share of the ceiling, memory.

    Parameters
    ----------
    found : mapping
        What `stages.benchmark_result.Benchmark.to_dict` returns.
    """
    from rich.markup import escape
    from rich.table import Table

    table = Table(
        title=escape("\n".join(_heading(found))),
        title_justify="left",
        caption=escape("\n".join(_notes(found))),
        caption_justify="left",
    )
    table.add_column("part", no_wrap=True)
    for heading in ("baseline", "product", "times as fast", "of ceiling", "peak memory, GB"):
        table.add_column(heading, justify="right", no_wrap=True)
    for part in found["parts"]:
        table.add_row(MEANING[part["part"]].format_map(found["settings"]), *_cells(part))
    return table


def _heading(found: Mapping[str, Any]) -> list[str]:
    machine, settings, ceiling = found["machine"], found["settings"], found["ceiling"]
    sensor, points = settings["sensor"], settings["points"]
    instructions = f" ({', '.join(machine['instructions'])})" if machine["instructions"] else ""
    processor = f"{machine['processor']}{instructions}, {machine['threads']} threads"
    device = "" if machine["device"] == "cpu" else f", {machine['device']}"
    image = f"{sensor['height']}×{sensor['width']}, {ceiling['precision']}"
    average = sum(points) // len(points)
    return [
        f"{processor}, torch {machine['torch_version']}{device}",
        f"{sensor['name']}, {image}; {len(points)} scans of {average:,} points on average",
    ]


def _notes(found: Mapping[str, Any]) -> list[str]:
    ceiling, settings = found["ceiling"], found["settings"]
    operations, moved = ceiling["operations"] / 1e9, ceiling["bytes"] / 1e9
    timed, samples = settings["baseline_passes_timed"], settings["samples"]
    notes = [
        f"Medians of {settings['rounds']} rounds; lowest and highest ratio of a round in brackets. "
        "Of --help, seconds of the processor.",
        f"Ceiling: {operations:,.0f} GFLOP/s of a matrix product in {ceiling['precision']}, "
        f"{moved:,.1f} GB/s of a memory copy.",
    ]
    if any(part["part"] == "uncertainty" for part in found["parts"]) and timed != samples:
        passes = "1 is" if timed == 1 else f"{timed} are"
        notes.append(f"Of the baseline's {samples} passes, all alike, {passes} timed.")
    return notes


def _cells(part: Mapping[str, Any]) -> list[str]:
    baseline, product, ratio = part["baseline"], part["product"], part["ratio"]
    share = part["share_of_ceiling"]
    return [
        _time(baseline["median"]) if baseline else NOTHING,
        _time(product["median"]),
        f"{ratio['median']:.3g} × ({ratio['lowest']:.3g} to {ratio['highest']:.3g})"
        if ratio
        else NOTHING,
        NOTHING if share is None else f"{share:.1%}",
        " / ".join(_memory(side) for side in (baseline, product) if side),
    ]


def _time(seconds: float) -> str:
    return f"{seconds:.2f} s " if seconds >= 1 else f"{seconds * 1e3:.3g} ms"


def _memory(side: Mapping[str, Any]) -> str:
    """Return the peak: of the GPU where there is one, else of the process."""
    peak = side["device_peak_bytes"] or side["peak_bytes"]
    return NOTHING if peak is None else f"{peak / 1e9:.2f}"
