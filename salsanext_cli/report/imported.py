# SPDX-License-Identifier: MIT
"""Imported labels in a table and in words, for a terminal."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.markup import escape
from rich.table import Table

from salsanext_cli.errors import counted, first_few
from salsanext_cli.labelling.label_records import LabelImport
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


def imported_lines(made: LabelImport, dataset: Path) -> Iterator[str]:
    """Yield a line about what was imported, and one about each group of scans that was not."""
    failed = sum(len(failure["files"]) for failure in made.failures)
    others = f", {counted(failed, 'file')} failed" if failed else ""
    yield f"import-labels: {counted(len(made.scans), 'scan')}{others} → {dataset}"
    if shares := made.largest_classes():
        named = ", ".join(f"{name} {100 * share:.1f} %" for name, share in shares.items())
        yield f"largest classes: {named}"
    if made.unedited:
        files = f"{counted(len(made.unedited), 'file')}: {first_few(made.unedited)}"
        yield f"not imported, since they hold the first guess of `pick`, {files}"
    if made.kept:
        yield f"without an edited file, as they were: {counted(made.kept, 'scan')}"
    if made.first_guesses:
        scans = f"{counted(len(made.first_guesses), 'scan')}: {first_few(made.first_guesses)}"
        yield f"warning: labelled by the network only, as `pick` left them, {scans}"
