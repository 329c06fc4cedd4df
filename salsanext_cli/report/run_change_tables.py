# SPDX-License-Identifier: MIT
"""Tables for a terminal of what changed between two runs on the same scans."""

from __future__ import annotations

from rich.console import Group
from rich.table import Table

from salsanext_cli.core.measures.paired import Difference
from salsanext_cli.core.texts import counted
from salsanext_cli.report.run_changes import (
    FEW_PARTS,
    has_intervals,
    many_scores_text,
    run_name,
    scores_by_name,
)
from salsanext_cli.report.tables import ABSENT, percent, table_of
from salsanext_cli.runs.summary.run_comparison import RunComparison

INTERVAL = "interval: paired bootstrap over {parts} drives or parts of drives; clear: without 0"
MAYBE_TRAINED_ON = "the weights may have been trained on these scans"


def comparison_tables(comparison: RunComparison) -> Group:
    """Return tables of the scores, if any, of changed labels and of the most changed scans."""
    tables: list[Table | str] = []
    scores = scores_by_name(comparison)
    if scores:
        tables.append(_score_table(comparison, scores))
    same = f"{percent(comparison.agreement)} % of the labels are the same"
    labels = f"{counted(comparison.scans, 'scan')}: {same}"
    if not comparison.label_changes:
        return Group(*tables, labels)
    label_changes = [
        (change.before, change.after, f"{change.points:,}", percent(change.share))
        for change in comparison.label_changes
    ]
    headings = ("before", "after", "points", "of the class %")
    tables.append(table_of(headings, label_changes, texts=["after"], title=labels))
    if comparison.scans > 1:
        tables.append(_scan_table(comparison))
    return Group(*tables)


def _score_table(comparison: RunComparison, scores: dict[str, Difference]) -> Table:
    """Return a table of each score in both runs, its change and the interval of that."""
    rows = [
        (
            name,
            percent(difference.before),
            percent(difference.after),
            _signed(difference.change),
            _interval_text(difference),
            "clear" if difference.is_clear else "",
        )
        for name, difference in scores.items()
    ]
    names = f"{run_name(comparison.before)} → {run_name(comparison.after)}"
    notes = [FEW_PARTS]
    if has_intervals(comparison):
        notes = [INTERVAL.format(parts=comparison.parts), many_scores_text(comparison)]
    if comparison.training_scans is None:
        notes.append(MAYBE_TRAINED_ON)
    return table_of(
        ("score", "before %", "after %", "change, percentage points", "95 % interval", ""),
        rows,
        title=f"{names}: {counted(comparison.scored, 'scan')} with labels",
        caption="\n".join(notes),
    )


def _scan_table(comparison: RunComparison) -> Table:
    """Return a table of the most changed scans."""
    rows = [
        (
            change.scan,
            percent(change.changed),
            ABSENT if change.accuracy is None else _signed(change.accuracy),
        )
        for change in comparison.most_changed
    ]
    headings = ("scan", "changed %", "change of accuracy, percentage points")
    return table_of(headings, rows, title="Most changed scans")


def _signed(share: float) -> str:
    return f"{100 * share:+.1f}"


def _interval_text(difference: Difference) -> str:
    """Return the ends of the interval of a change; "–" without one."""
    if difference.low is None or difference.high is None:
        return ABSENT
    return f"{_signed(difference.low)} … {_signed(difference.high)}"
