# SPDX-License-Identifier: MIT
"""Comparison of two runs on the same scans: its record, which `compare` writes and pages read."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import OutputError
from salsanext_cli.core.measures.paired import (
    Difference,
    agreement,
    consecutive_parts,
    score_differences,
)
from salsanext_cli.core.measures.scores import Counts, largest_confusions
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.io.files.json_files import read_record
from salsanext_cli.io.files.reading import is_folder
from salsanext_cli.runs.results.folder_names import PREDICTION_STAGES
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.scans.scan_file import drive_order
from salsanext_cli.runs.summary.run_pair import RunPair, ScanPair
from salsanext_cli.version import __version__

RECORD = "compare.json"
PICTURE = "compare.png"
CHANGED_SCAN = "compare_scan.png"
FILES = (RECORD, PICTURE, CHANGED_SCAN)
"""Files of a comparison, in the folder of the second run."""
MAX_LISTED = 10  # Scans, and pairs of classes
UNKNOWN_SOURCES = {"truth": "labels", "before": "first run", "after": "second run"}
"""Names of the labels whose ids may be unknown."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelChange:
    """Points that have one label in the first run and another in the second."""

    before: str  # Name of a class
    after: str
    points: int
    share: float  # Of the points of the class in the first run, 0…1


@dataclass(frozen=True, slots=True, kw_only=True)
class ClassChange:
    """One class in two runs."""

    name: str
    points: int  # Number of points of the class in the first run
    same: float | None  # Share of them with the same label in the second run, 0…1; None for none
    iou: Difference | None  # None without true labels of the class


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanChange:
    """One scan in two runs."""

    scan: str  # Sequence and stem
    changed: float  # Share of the points with another label, 0…1
    accuracy: float | None  # Change of the share of right labels, -1…1; None without true labels


@dataclass(frozen=True, slots=True, kw_only=True)
class RunComparison:
    """Comparison of two runs on the same scans."""

    before: str  # Output folder of the first run
    after: str
    label_space: str  # Name of the classes
    scans: int  # Number of scans with labels of both runs
    scored: int  # Number of scans with true labels that the weights of no run were trained on
    # Number of scans that the weights of a run were trained on; None if a record of them is missing
    training_scans: int | None
    missing: tuple[str, ...]  # Scans that a run was asked for, without labels of both
    not_asked_for: int  # Number of the other scans without labels
    unknown_ids: Mapping[str, Mapping[str, int]]  # Points by unknown id: `truth`, `before`, `after`
    parts: int  # Number of drives, or parts of drives, that the intervals are about
    agreement: float  # Share of the points with the same label, 0…1
    accuracy: Difference | None  # None without true labels
    iou_mean: Difference | None
    classes: tuple[ClassChange, ...]  # Classes with points in the first run or in the truth
    label_changes: tuple[LabelChange, ...]  # Most frequent changes of labels
    most_changed: tuple[ScanChange, ...]  # Scans with the largest share of changed labels
    weights: tuple[str | None, str | None]  # SHA-256 of the weights of both runs
    # Digests of the settings of both runs, by stage
    origins: tuple[Mapping[str, str], Mapping[str, str]]

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        data = {name: plain(getattr(self, name)) for name in self.__slots__}
        return {"stage": "compare", "version": __version__, **data}

    def warnings(self) -> Iterator[str]:
        """Yield reasons to doubt the comparison, in words."""
        labelled = self.scored + (self.training_scans or 0)
        if self.training_scans:
            scans = f"{self.training_scans:,} of {counted(labelled, 'labelled scan')}"
            yield f"{scans} skipped: the weights of a run were trained on them"
        for source, ids in self.unknown_ids.items():
            if ids:
                listed = first_few([f"{i} ({count:,}×)" for i, count in ids.items()])
                yield f"{UNKNOWN_SOURCES[source]}: unknown ids {listed} count as unlabelled"


def run_comparison(pairs: Sequence[ScanPair], runs: RunPair) -> RunComparison:
    """Compare two runs by the numbers of their scans, of which there is at least one."""
    ordered = sorted(pairs, key=lambda pair: drive_order(pair.file))
    scored = [pair for pair in ordered if pair.sums is not None and not pair.trained_on]
    differences = None
    if scored:
        sums = np.array([pair.sums for pair in scored])
        parts = consecutive_parts([pair.file.sequence for pair in scored])
        differences = score_differences(sums, parts)
    space = runs.space
    before = Provenance(runs.before)
    after = Provenance(runs.after)
    is_known = not any(recorded.missing for recorded in runs.trained_on)
    ious = differences.classes if differences else {}
    transitions: Counts = np.sum([pair.transitions for pair in ordered], axis=0)
    return RunComparison(
        before=str(runs.before),
        after=str(runs.after),
        label_space=space.name,
        scans=len(ordered),
        scored=len(scored),
        training_scans=sum(pair.trained_on for pair in ordered) if is_known else None,
        missing=tuple(scan.name for scan in runs.missing.scans),
        not_asked_for=runs.missing.not_asked_for,
        unknown_ids=_unknown_ids(ordered),
        parts=differences.parts if differences else 0,
        agreement=agreement(transitions),
        accuracy=differences.accuracy if differences else None,
        iou_mean=differences.iou_mean if differences else None,
        classes=_class_changes(transitions, ious, space),
        label_changes=_label_changes(transitions, space),
        most_changed=_most_changed(ordered),
        weights=(before.weights("predictions"), after.weights("predictions")),
        origins=(before.origins(PREDICTION_STAGES), after.origins(PREDICTION_STAGES)),
    )


def _unknown_ids(pairs: Sequence[ScanPair]) -> dict[str, dict[str, int]]:
    """Return the points of all scans by source and unknown raw id."""
    sums: dict[str, Counter[int]] = {source: Counter() for source in UNKNOWN_SOURCES}
    for pair in pairs:
        for source, ids in pair.unknown.items():
            sums[source].update(ids)
    return {
        source: {str(i): count for i, count in sorted(ids.items())} for source, ids in sums.items()
    }


def _class_changes(
    transitions: Counts, ious: Mapping[int, Difference], space: LabelSpace
) -> tuple[ClassChange, ...]:
    """Return the classes with labels or with a score, in the order of the train ids."""
    points = transitions.sum(axis=1).tolist()
    same = transitions.diagonal().tolist()
    return tuple(
        ClassChange(
            name=space.names[i],
            points=points[i],
            same=same[i] / points[i] if points[i] else None,
            iou=ious.get(i),
        )
        for i in range(space.class_count)
        if (i or space.scored[0]) and (points[i] or i in ious)
    )


def _label_changes(transitions: Counts, space: LabelSpace) -> tuple[LabelChange, ...]:
    """Return the most frequent changes of labels, the largest first."""
    points = transitions.sum(axis=1).tolist()
    return tuple(
        LabelChange(
            before=space.names[c.true],
            after=space.names[c.predicted],
            points=c.points,
            share=c.points / points[c.true],
        )
        for c in largest_confusions(transitions, MAX_LISTED)
    )


def _most_changed(pairs: Sequence[ScanPair]) -> tuple[ScanChange, ...]:
    """Return the scans with the largest share of changed labels, the largest first."""
    changes = [
        ScanChange(
            scan=pair.file.name, changed=1 - agreement(pair.transitions), accuracy=_gain(pair.sums)
        )
        for pair in pairs
    ]
    differing = [change for change in changes if change.changed]
    return tuple(sorted(differing, key=lambda change: -change.changed)[:MAX_LISTED])


def _gain(sums: Counts | None) -> float | None:
    """Return the change of the share of right labels of a scan; None without true labels."""
    if sums is None or not sums[0, 1].any():
        return None
    before, after = sums[:, 0].sum(axis=1).tolist()
    return float(after - before) / int(sums[0, 1].sum())


def recorded_comparison(out: Path) -> RunComparison | None:
    """Return the comparison of a run with an earlier one; None without one of their present labels.

    A file of an earlier version, or of somebody else, is none. An earlier run whose folder is gone
    is not checked.
    """
    with suppress(OutputError):
        comparison = read_record(RunComparison, out / RECORD)
        if comparison and _is_current(comparison, out):
            return comparison
    return None


def _is_current(comparison: RunComparison, out: Path) -> bool:
    """Return whether both runs have the settings that were compared, the weights among them."""
    before, after = comparison.origins
    first = Path(comparison.before)
    if is_folder(first) and Provenance(first).origins(PREDICTION_STAGES) != before:
        return False
    return Provenance(out).origins(PREDICTION_STAGES) == after
