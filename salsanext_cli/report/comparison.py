# SPDX-License-Identifier: MIT
"""Tables of what changed between two runs."""

import numpy as np
from rich.console import Group
from rich.table import Table

from salsanext_cli.errors import counted
from salsanext_cli.measures.paired import Difference, RunComparison, changed
from salsanext_cli.report.tables import ABSENT, percent, table_of

INTERVAL = "* the interval over scans excludes 0; for scans of one drive it is too narrow\n"
ACCEPTED = "coverage: share of points with a label; risk: share of wrong labels among them"
DIFFERENCE = ("before %", "after %", "difference", "95 % interval")


def _signed(share: float) -> str:
    return ABSENT if np.isnan(share) else f"{100 * share:+.1f}"


def _cells(score: Difference) -> tuple[str, ...]:
    clear = "*" * (score.low > 0 or score.high < 0)
    interval = f"{_signed(score.low)} … {_signed(score.high)}{clear:1}"
    interval = ABSENT if np.isnan(score.low) else interval
    return percent(score.before), percent(score.after), _signed(score.difference), interval


def comparison_tables(compared: RunComparison) -> Group:
    """Return tables of the scores, if any, of changed labels and of the most changed scans."""
    tables: list[Table | str] = []
    if compared.scores:
        rows = [(name, *_cells(score)) for name, score in compared.scores.items()]
        title = f"{counted(len(compared.sums), 'scan')} with labels, not trained on"
        caption = INTERVAL + (ACCEPTED if compared.rejecting else "score of a class: its IoU")
        tables.append(table_of(("score", *DIFFERENCE), rows, title=title, caption=caption))
    if seen := sum(pair.trained_on for pair in compared.pairs):
        which = "all scans" if seen == len(compared.pairs) else counted(seen, "scan")
        tables.append(f"{which} not scored: the weights of a run were trained on them")
    labels = f"Labels of {counted(len(compared.pairs), 'scan')}"
    if not (most_changed := compared.most_changed()):
        return Group(*tables, f"{labels}: all are the same")
    turns = (
        (before, after, f"{points:,}", percent(share))
        for before, after, points, share in compared.turns()
    )
    title = f"{labels}: {percent(1 - changed(compared.turned))} % are the same"
    headings = ("before", "after", "points", "share %")
    tables.append(table_of(headings, turns, texts=["after"], title=title))
    scans = []
    for pair in most_changed:
        numbers = percent(changed(pair.turned)), _signed(compared.difference(pair))
        scans.append((pair.file.name, *numbers, "trained on" * pair.trained_on))
    headings = ("scan", "changed %", "risk" if compared.rejecting else "accuracy", "note")
    return Group(*tables, table_of(headings, scans, title="Most changed scans"))
