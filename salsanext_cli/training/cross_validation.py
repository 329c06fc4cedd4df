# SPDX-License-Identifier: MIT
"""Cross-validation of a training: its folds, the number of epochs that it chooses, its scores."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.run_folder import Row

Parts = list[tuple[list[ScanFile], list[ScanFile]]]


def folds(files: Sequence[ScanFile], count: int) -> list[list[ScanFile]]:
    """Divide scans into at most `count` folds, each of whole sequences or of neighbours in one."""
    sequences = [list(members) for _, members in groupby(files, lambda file: file.sequence)]
    if len(sequences) == 1:
        indices_of_folds = np.array_split(np.arange(len(files)), min(count, len(files)))
        return [[files[i] for i in indices] for indices in indices_of_folds]
    divided: list[list[ScanFile]] = [[] for _ in range(min(count, len(sequences)))]
    for sequence in sorted(sequences, key=len, reverse=True):
        min(divided, key=len).extend(sequence)
    number_of = {file: number for number, file in enumerate(files)}
    return [sorted(fold, key=number_of.__getitem__) for fold in divided]


def held_out(files: Sequence[ScanFile], count: int = 5) -> Parts:
    """Return the other scans and the scans of each fold; nothing for a single scan."""
    if len(files) < 2:
        return []
    return [(others_of(files, fold), fold) for fold in folds(files, count)]


def others_of(files: Iterable[ScanFile], fold: Iterable[ScanFile]) -> list[ScanFile]:
    """Return the scans that are not in a fold, in their order."""
    members = set(fold)
    return [file for file in files if file not in members]


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """Scores on held-out scans: means over the folds, an estimate for new scans.

    Each fold is scored after the number of epochs that the others choose. Spreads are sample
    standard deviations, None for a single fold.
    """

    epochs: int  # Number of epochs with the highest mean IoU over the folds
    miou: float
    miou_spread: float | None
    accuracy: float
    accuracy_spread: float | None
    temperature: float  # Geometric mean over the folds
    folds: int
    miou_before: float | None = None  # Means over the folds of the initial weights
    accuracy_before: float | None = None
    one_drive: bool = False  # All scans are of one sequence, so that other sites may be harder

    def scores(self) -> dict[str, float]:
        """Return the scores for the card of the weights."""
        scores = {
            "folds": self.folds,
            "miou": self.miou,
            "miou_spread": self.miou_spread,
            "accuracy": self.accuracy,
            "accuracy_spread": self.accuracy_spread,
        }
        return {name: value for name, value in scores.items() if value is not None}


def expectation(logs: Sequence[Sequence[Row]], *, one_drive: bool = False) -> Expectation | None:
    """Choose the number of epochs by the logs of the folds, None if no fold could be scored."""
    validated = [
        {int(row["epoch"]): row for row in rows if math.isfinite(row.get("miou", math.nan))}
        for rows in logs
    ]
    scored = [rows for rows in validated if rows]
    if not scored:
        return None
    common = sorted(set.intersection(*(set(rows) for rows in scored)))
    epochs = _best(common, scored)
    held_out_rows = []
    for rows in scored:
        others = [other for other in scored if other is not rows]
        held_out_rows.append(rows[_best(common, others or scored)])
    scores = np.array([(row["miou"], row["accuracy"]) for row in held_out_rows])
    miou, accuracy = scores.mean(axis=0).tolist()
    miou_spread = None
    accuracy_spread = None
    if len(scores) > 1:
        miou_spread, accuracy_spread = scores.std(axis=0, ddof=1).tolist()
    logarithms = [np.log(rows[epochs]["temperature"]) for rows in scored]
    return Expectation(
        epochs=epochs,
        miou=miou,
        miou_spread=miou_spread,
        accuracy=accuracy,
        accuracy_spread=accuracy_spread,
        temperature=float(np.exp(np.mean(logarithms))),
        folds=len(scored),
        one_drive=one_drive,
    )


def _best(epochs: Sequence[int], logs: Sequence[dict[int, Row]]) -> int:
    """Return the number of epochs with the highest mean IoU, the fewest among equals."""
    return max(epochs, key=lambda epoch: np.mean([rows[epoch]["miou"] for rows in logs]))
