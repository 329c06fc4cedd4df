# SPDX-License-Identifier: MIT
"""Draw how well few passes and copies estimate uncertainty, by an example, and measure it."""

from __future__ import annotations

import runpy
from functools import cache
from pathlib import Path
from typing import Any

from measurements import percent

EXAMPLE = Path(__file__).parents[2] / "examples/uncertainty_figures.py"
SCAN = "semantickitti/sequences/00/velodyne/000000.bin"
COPIES = 256
PASSES = 200
DOTS = 100


@cache
def functions() -> dict[str, Any]:
    """Return the functions of the example, which is not part of any package."""
    return runpy.run_path(str(EXAMPLE))


@cache
def comparison(data: Path) -> Any:
    """Return the comparison of the example."""
    return functions()["compared"](data / SCAN, COPIES, PASSES)


def measured(data: Path) -> dict[str, str]:
    """Return the figures that the page shows."""
    found = comparison(data)
    copies, filtering = found.fast
    values = {
        "copies": f"{found.rank(copies):.3f}",
        "filtering": f"{found.rank(filtering):.3f}",
        "filtering_smaller": f"{1 / found.scale(filtering):.0f}",
    }
    for count, rank in found.ranks.items():
        values[f"rank_{count}"] = f"{rank:.3f}"
        values[f"error_{count}"] = f"{float(percent(found.errors[count])):.0f}"
    return values


def draw(data: Path, picture: Path) -> None:
    """Write the figure of the example."""
    functions()["drawn"](comparison(data)).savefig(picture, dpi=DOTS)
