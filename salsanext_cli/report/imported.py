# SPDX-License-Identifier: MIT
"""Table of imported labels, for a terminal."""

from collections.abc import Mapping, Sequence
from typing import Any

from rich.markup import escape
from rich.table import Table

from salsanext_cli.report.tables import number_table

COUNTS = ("points", "labelled", "unlabelled", "ambiguous", "missing")


def imported_table(scans: Sequence[Mapping[str, Any]]) -> Table:
    """Return a table with the numbers of points of each imported scan, and of all."""
    table = number_table("scan", *COUNTS, no_wrap=True)
    table.add_column("from")
    for scan in scans:
        counts = (f"{scan[name]:,}" for name in COUNTS)
        table.add_row(escape(scan["scan"]), *counts, escape(scan["scalar"]))
    table.add_section()
    totals = (sum(scan[name] for scan in scans) for name in COUNTS)
    table.add_row("all", *(f"{total:,}" for total in totals))
    return table
