# SPDX-License-Identifier: MIT
"""Section of a page about what changed since another run, which `compare` has recorded."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.core.measures.paired import Difference
from salsanext_cli.core.texts import counted
from salsanext_cli.report.run_change_tables import MAYBE_TRAINED_ON
from salsanext_cli.report.run_changes import (
    FEW_PARTS,
    change_text,
    has_intervals,
    many_scores_text,
    scores_by_name,
)
from salsanext_cli.report.tables import percent
from salsanext_cli.runs.summary.run_comparison import (
    CHANGED_SCAN,
    PICTURE,
    LabelChange,
    RunComparison,
    recorded_comparison,
)

SCORES = {PICTURE: "Change of each score with its interval, around a line at zero"}
AGREEMENT = {PICTURE: "Share of the points of each class with the same label in both runs"}
CHANGES = {CHANGED_SCAN: "The most changed scan from above, by the labels of both runs"}


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreRow:
    """A score in two runs, in texts."""

    name: str
    before: str
    after: str
    change: str
    outcome: str  # "better" or "worse" if the change is clear, else empty


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeFigure:
    """Picture of a comparison."""

    description: str
    address: str  # The picture itself, as an address for `img`


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherRun:
    """What changed since another run."""

    folder: str  # Of the other run
    summary: str
    scores: Sequence[ScoreRow]  # Empty without labels
    notes: Sequence[str]  # What limits the scores, in words
    label_changes: Sequence[str]  # Most frequent changes of labels, in words
    figures: Sequence[ChangeFigure]


def other_run(out: Path) -> OtherRun | None:
    """Return what changed since another run, None if nothing is recorded of the present labels."""
    comparison = recorded_comparison(out)
    if comparison is None:
        return None
    scores = scores_by_name(comparison)
    pictures = (SCORES if scores else AGREEMENT) | CHANGES
    return OtherRun(
        folder=comparison.before,
        summary=_summary(comparison),
        scores=[_row(name, score) for name, score in scores.items()],
        notes=_notes(comparison),
        label_changes=[_label_change_text(change) for change in comparison.label_changes],
        figures=[
            ChangeFigure(description=title, address=_address(out / name))
            for name, title in pictures.items()
            if (out / name).is_file()
        ],
    )


def _summary(comparison: RunComparison) -> str:
    """State the number of scans and how many labels are the same."""
    same = percent(comparison.agreement, 1, " %")
    scored = f", {comparison.scored:,} of them with labels" if comparison.scored else ""
    scans = f"{counted(comparison.scans, 'scan')}{scored}"
    return f"{scans}: {same} of the labels are the same."


def _notes(comparison: RunComparison) -> list[str]:
    """State what limits the scores of two runs, in words."""
    notes = [many_scores_text(comparison) if has_intervals(comparison) else FEW_PARTS]
    if comparison.training_scans is None:
        notes.append(MAYBE_TRAINED_ON)
    return notes


def _row(name: str, difference: Difference) -> ScoreRow:
    """Return a row of the table of scores."""
    outcome = ""
    if difference.is_clear:
        outcome = "better" if difference.change > 0 else "worse"
    return ScoreRow(
        name=name,
        before=percent(difference.before),
        after=percent(difference.after),
        change=change_text(difference),
        outcome=outcome,
    )


def _label_change_text(change: LabelChange) -> str:
    """State how many points of a class have another label now."""
    share = percent(change.share, 1, " %")
    points = counted(change.points, "point")
    return f"{change.before} became {change.after}: {points}, {share} of the class"


def _address(path: Path) -> str:
    """Return a picture as an address for `img`."""
    return f"data:image/png;base64,{b64encode(path.read_bytes()).decode('ascii')}"
