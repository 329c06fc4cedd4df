# SPDX-License-Identifier: MIT
"""Count how far the probabilities and uncertainties of one scan can be trusted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.formats.point_values import read_probabilities, read_uncertainty
from salsanext_cli.formats.reading import present
from salsanext_cli.measures.calibration import Calibration, judge
from salsanext_cli.measures.distance import RING_NAMES
from salsanext_cli.measures.ranking import Ranking
from salsanext_cli.measures.softmax import lack_of_confidence, softmax_entropy
from salsanext_cli.measures.tally import Tally
from salsanext_cli.records import Float
from salsanext_cli.storage.layout import SUFFIX_OF_FOLDER, ScanFile, output_path

UNCERTAINTY = "uncertainty/"
FOLDERS = ("probabilities", *(f for f in SUFFIX_OF_FOLDER if f.startswith(UNCERTAINTY)))
"""What is looked for in the output folder, beside the predictions."""
OF_SOFTMAX = {"confidence": lack_of_confidence, "softmax_entropy": softmax_entropy}
"""Uncertainties that come from the probabilities."""
KINDS = (*OF_SOFTMAX, *(folder.removeprefix(UNCERTAINTY) for folder in FOLDERS[1:]))
"""Every kind of uncertainty, in the order in which they are reported."""
CLASS, RING = "class", "ring"
"""What points are grouped by."""
NO_RING = len(RING_NAMES)
"""The group of points without a measurement."""

Key = TypeVar("Key")
Counted = TypeVar("Counted", bound=Tally)
Groups = Mapping[str, tuple[npt.NDArray[Any], int]]


@dataclass(frozen=True, slots=True)
class UncertaintyCounts:
    """What counting gives; adding two gives the counts of both.

    Attributes
    ----------
    files : Counter of str
        Number of scans that have a file, by folder.
    calibrations : dict of str to Calibration
        By what the points are grouped by: `CLASS`, the most probable one, or `RING`.
    rankings : dict of (str, str) to Ranking
        By kind of uncertainty and by what the points are grouped by: `CLASS`, the true one, or
        `RING`.
    """

    files: Counter[str] = field(default_factory=Counter)
    calibrations: dict[str, Calibration] = field(default_factory=dict)
    rankings: dict[tuple[str, str], Ranking] = field(default_factory=dict)

    def __add__(self, other: UncertaintyCounts) -> UncertaintyCounts:
        return UncertaintyCounts(
            self.files + other.files,
            _joined(self.calibrations, other.calibrations),
            _joined(self.rankings, other.rankings),
        )


def _joined(one: dict[Key, Counted], other: dict[Key, Counted]) -> dict[Key, Counted]:
    both = {key: one[key] + other[key] for key in one.keys() & other.keys()}
    return one | other | both


def count_uncertainty(
    scan: ScanFile,
    out: Path,
    space: LabelSpace,
    truth: TrainIds,
    predicted: TrainIds,
    ring: npt.NDArray[np.intp] | None = None,
) -> UncertaintyCounts:
    """Count the points of a scan whose truth is scored, by whatever lies in the output folder.

    Parameters
    ----------
    scan : ScanFile
        The scan.
    out : Path
        Output folder with maybe `probabilities/` and `uncertainty/`.
    space : LabelSpace
        Which classes there are.
    truth, predicted : (N,) uint8
        Train ids.
    ring : (N,) int, optional
        Ring of each point, to be counted by too.

    Raises
    ------
    FormatError
        If a file cannot be read, is not of this scan, or holds what it cannot mean.
    """
    paths = {f: output_path(out, scan.sequence, f, scan.stem) for f in FOLDERS}
    paths = {folder: path for folder, path in paths.items() if present(path)}
    scored = space.scored[truth]
    truth, predicted = truth[scored], predicted[scored]
    values: dict[str, Float] = {}
    calibrations: dict[str, Calibration] = {}
    rings: Groups = {}
    if ring is not None:
        rings = {RING: (np.where(ring < 0, NO_RING, ring)[scored], NO_RING + 1)}
    if path := paths.get("probabilities"):
        softmax = read_probabilities(path, len(scored), space.class_count)[scored]
        if not space.scored[0]:
            _hide_points_without_pixel(softmax)
        calibrations = _calibrations(softmax, truth, rings)
        values = {kind: derive(softmax) for kind, derive in OF_SOFTMAX.items()}
    for kind in KINDS:
        if path := paths.get(UNCERTAINTY + kind):
            values[kind] = read_uncertainty(path, len(scored))[scored]
    groups = {CLASS: (truth, space.class_count), **rings}
    rankings = _rankings(values, predicted != truth, groups)
    return UncertaintyCounts(Counter(list(paths)), calibrations, rankings)


def _hide_points_without_pixel(softmax: npt.NDArray[np.float16]) -> None:
    """Make those NaN that `predict` marks as certainly unlabelled, which no softmax says."""
    softmax[softmax[:, 0] == 1] = np.nan


def _calibrations(
    softmax: npt.NDArray[np.float16], truth: TrainIds, rings: Groups
) -> dict[str, Calibration]:
    judged = judge(softmax, truth)
    groups = {CLASS: (judged.predicted, softmax.shape[1]), **rings}
    return {
        name: Calibration.none(count).update(judged, group)
        for name, (group, count) in groups.items()
    }


def _rankings(
    values: Mapping[str, Float], wrong: npt.NDArray[np.bool_], groups: Groups
) -> dict[tuple[str, str], Ranking]:
    return {
        (kind, name): Ranking.none(count).update(of_points, wrong, group)
        for kind, of_points in values.items()
        for name, (group, count) in groups.items()
    }
