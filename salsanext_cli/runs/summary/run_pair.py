# SPDX-License-Identifier: MIT
"""Two runs on the same scans: what makes them comparable, and the labels of one scan by both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace, TrainIds
from salsanext_cli.core.errors import LabelError, NoInputError, UsageError
from salsanext_cli.core.measures.paired import class_sums
from salsanext_cli.core.measures.scores import Counts, confusion_matrix, scored_rows
from salsanext_cli.core.network.card import is_among
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few, with_hint
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.io.formats.kitti_labels import read_labels
from salsanext_cli.runs.records.digest_files import RecordedScans
from salsanext_cli.runs.results.output_paths import output_path, with_outputs
from salsanext_cli.runs.results.query import ResultQuery
from salsanext_cli.runs.results.result_folder import ResultFolder
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import MissingResults, space_of_labels

OTHER_SCANS = "compare runs on the same scans"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanPair:
    """Labels of one scan by two runs, in numbers."""

    file: ScanFile
    transitions: Counts  # (C, C): points by label of the first run and of the second
    sums: Counts | None  # (2, 3, C): `class_sums` of both runs; None without true labels
    trained_on: bool  # Whether the weights of a run were trained on the scan
    unknown: Mapping[str, Mapping[int, int]]  # Points by unknown raw id: `truth`, `before`, `after`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairedLabels:
    """Train ids of the points of a scan by two runs."""

    before: TrainIds  # (N,)
    after: TrainIds  # (N,)
    unknown: Mapping[str, Mapping[int, int]]  # Points by unknown raw id: `before`, `after`


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueLabels:
    """True train ids of the points of a scan."""

    train: TrainIds  # (N,)
    unknown: Mapping[int, int]  # Points by unknown raw id


@dataclass(frozen=True, slots=True, kw_only=True)
class RunPair:
    """Two output folders with labels of the same scans."""

    before: Path
    after: Path
    scans: Sequence[ScanFile]  # At least one
    space: LabelSpace  # Classes of both runs
    labels: LabelSpace  # Meaning of the raw ids of the true labels
    sensor: Sensor  # Sensor of the first run
    trained_on: Sequence[RecordedScans]  # Scans that the weights of each run were trained on
    missing: MissingResults = field(default_factory=MissingResults)  # Scans without labels
    # Names of the scans whose label files are pre-labels, or have the ids of another label space;
    # the stage `compare` states them
    unusable: frozenset[str] = frozenset()

    @classmethod
    def from_folders(cls, before: Path, after: Path, query: ResultQuery) -> RunPair:
        """Return two runs that can be compared.

        Parameters
        ----------
        before, after : Path
            Output folders of the first run and of the second.
        query : ResultQuery
            Choice of the scans, their data set and classes.

        Raises
        ------
        UsageError
            If the runs have other scans or classes, or a run rejected labels.
        """
        if before.resolve() == after.resolve():
            raise UsageError(after, "is the first run too", "the folder of another run")
        first = ResultFolder(before, query.dataset)
        second = ResultFolder(after, query.dataset)
        for run in (first, second):
            _require_all_labels(run)
        scans, space = first.predicted(query.selection, query.label_space, query.classes)
        other_scans, other_space = second.predicted(
            query.selection, query.label_space, query.classes
        )
        _require_same_classes(before, space, after, other_space)
        common = _require_same_scans(first, scans, second, other_scans)
        unlabelled = {*scans, *other_scans} - {*common}
        return cls(
            before=before,
            after=after,
            scans=common,
            space=space,
            labels=space_of_labels(common, space, query.label_space),
            sensor=first.provenance.sensor(),
            trained_on=[run.provenance.trained_on() for run in (first, second)],
            missing=_missing(first, second, unlabelled),
        )

    def warnings(self) -> Iterator[str]:
        """Yield which run lacks the digests of its training scans, in words."""
        for recorded in self.trained_on:
            if recorded.missing:
                question = "whether the weights were trained on these scans"
                headline = f"{recorded.missing}: is missing, so it is unknown {question}"
                yield with_hint(headline, recorded.hint)

    def labels_of(self, file: ScanFile) -> PairedLabels:
        """Read the labels of a scan by both runs."""
        paths = [
            output_path(out, file.sequence, "predictions", file.stem)
            for out in (self.before, self.after)
        ]
        before = read_labels(paths[0])
        after = read_labels(paths[1])
        if len(before) != len(after):
            problem = f"has {counted(len(after), 'label')}"
            expected = f"{len(before):,}, as {paths[0]}"
            raise LabelError(paths[1], problem, expected, OTHER_SCANS)
        return PairedLabels(
            before=self.space.to_train(before, strict=False, source=paths[0]),
            after=self.space.to_train(after, strict=False, source=paths[1]),
            unknown={
                "before": self.space.unknown_ids(before),
                "after": self.space.unknown_ids(after),
            },
        )

    def truth_of(self, file: ScanFile, count: int) -> TrueLabels | None:
        """Read the true labels of a scan of `count` points; None without usable ones."""
        if file.name in self.unusable or not present(file.label_path):
            return None
        raw = read_labels(file.label_path, count)
        return TrueLabels(
            train=self.labels.to_train(raw, strict=False, source=file.label_path),
            unknown=self.labels.unknown_ids(raw),
        )

    def count(self, file: ScanFile) -> ScanPair:
        """Count the points of a scan by the labels of both runs, and by the truth if there is."""
        labels = self.labels_of(file)
        classes = self.space.class_count
        transitions = confusion_matrix(labels.before, labels.after, classes)
        truth = self.truth_of(file, len(labels.before))
        if truth is None:
            return ScanPair(
                file=file,
                transitions=transitions,
                sums=None,
                trained_on=False,
                unknown=labels.unknown,
            )
        sums = [
            class_sums(scored_rows(confusion_matrix(truth.train, predicted, classes), self.space))
            for predicted in (labels.before, labels.after)
        ]
        digests = frozenset[str]().union(*(recorded.digests for recorded in self.trained_on))
        return ScanPair(
            file=file,
            transitions=transitions,
            sums=np.array(sums),
            # The scan is read only if a digest begins with its number of points.
            trained_on=is_among(
                digests, len(truth.train), lambda: read_scan(file.path, self.sensor)
            ),
            unknown={"truth": truth.unknown, **labels.unknown},
        )


def _require_all_labels(run: ResultFolder) -> None:
    """Refuse a run that rejected labels, which are neither right nor wrong."""
    if run.provenance.rejected_above() is not None:
        problem = "rejected labels, which are neither right nor wrong"
        hint = "compare coverage and risk, which `salsanext eval` prints for each run"
        raise UsageError(run.root, problem, "a run with all labels", hint)


def _require_same_classes(
    before: Path, space: LabelSpace, after: Path, other_space: LabelSpace
) -> None:
    """Refuse runs with different classes."""
    if not space.fits(other_space):
        named = first_few(space.differences(other_space))
        hint = f"merge both with {setting('classes', 'coarse')}"
        raise UsageError(after, f"has other classes than {before}: {named}", hint=hint)


def _require_same_scans(
    first: ResultFolder,
    scans: Iterable[ScanFile],
    second: ResultFolder,
    other_scans: Iterable[ScanFile],
) -> list[ScanFile]:
    """Return the scans with labels of both runs; refuse labels of other scans or points."""
    first_by_name = _labelled(first, scans)
    second_by_name = _labelled(second, other_scans)
    alone = sorted(first_by_name.keys() ^ second_by_name.keys())
    if alone:
        problem = f"only one of the runs has labels of {counted(len(alone), 'scan')}"
        hint = f"choose the scans of both with {argument('sequences')} or {argument('split')}"
        raise UsageError(second.root, f"{problem}: {first_few(alone)}", "the same scans", hint)
    if not first_by_name:
        raise NoInputError(second.root, "contains no labels", hint="run `salsanext predict` first")
    common = list(first_by_name.values())
    for _, members in groupby(common, lambda scan: scan.sequence):
        scan = next(members)
        _require_same_points(scan, second_by_name[scan.name], first.provenance.sensor())
    return common


def _missing(
    first: ResultFolder, second: ResultFolder, unlabelled: set[ScanFile]
) -> MissingResults:
    """Divide scans without labels in either run by whether a stage of either was asked for them."""
    missing: set[ScanFile] = set()
    for run in (first, second):
        missing.update(run.missing_predictions(unlabelled).scans)
    return MissingResults(
        scans=tuple(sorted(missing)), not_asked_for=len(unlabelled) - len(missing)
    )


def _labelled(run: ResultFolder, scans: Iterable[ScanFile]) -> dict[str, ScanFile]:
    """Return the scans with labels of a run, by name."""
    return {scan.name: scan for scan in with_outputs(scans, run.root, "predictions")}


def _require_same_points(scan: ScanFile, other: ScanFile, sensor: Sensor) -> None:
    """Refuse two files of a scan with different points."""
    if scan.path == other.path:
        return
    points = read_scan(scan.path, sensor).points
    other_points = read_scan(other.path, sensor).points
    if not np.array_equal(points, other_points, equal_nan=True):
        raise UsageError(other.path, f"has other points than {scan.path}", hint=OTHER_SCANS)
