# SPDX-License-Identifier: MIT
"""Cross-validation of a training: its folds, the number of epochs that it chooses, its scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.training.run_folder import Row

Parts = list[tuple[list[ScanFile], list[ScanFile]]]


def folds(files: Sequence[ScanFile], count: int) -> list[list[ScanFile]]:
    """Divide scans into at most `count` folds, each of whole sequences or of neighbours in one."""
    sequences = [list(members) for _, members in groupby(files, lambda file: file.sequence)]
    if len(sequences) == 1:
        parts = np.array_split(np.arange(len(files)), min(count, len(files)))
        return [[files[i] for i in part] for part in parts]
    divided: list[list[ScanFile]] = [[] for _ in range(min(count, len(sequences)))]
    for sequence in sorted(sequences, key=len, reverse=True):
        min(divided, key=len).extend(sequence)
    return [sorted(fold, key=files.index) for fold in divided]


def held_out(files: Sequence[ScanFile], count: int = 5) -> Parts:
    """Return the other scans and the scans of each fold; nothing for a single scan."""
    parts = folds(files, count) if len(files) > 1 else []
    return [([file for file in files if file not in part], part) for part in parts]


@dataclass(frozen=True, slots=True)
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
        names = ("folds", "miou", "miou_spread", "accuracy", "accuracy_spread")
        return {name: value for name in names if (value := getattr(self, name)) is not None}


def expectation(logs: Sequence[Sequence[Row]], *, one_drive: bool = False) -> Expectation | None:
    """Choose the number of epochs by the logs of the folds, None if no fold could be scored."""
    validated = [
        {int(row["epoch"]): row for row in rows if row.get("miou", np.nan) == row.get("miou")}
        for rows in logs
    ]
    scored = [rows for rows in validated if rows]
    if not scored:
        return None
    common = sorted(set.intersection(*(set(rows) for rows in scored)))
    epochs = _best(common, scored)
    of_folds = [
        rows[_best(common, [other for other in scored if other is not rows] or scored)]
        for rows in scored
    ]
    values = np.array([(row["miou"], row["accuracy"]) for row in of_folds])
    miou, accuracy = values.mean(axis=0).tolist()
    spreads = values.std(axis=0, ddof=1).tolist() if len(values) > 1 else (None, None)
    temperature = float(np.exp(np.mean([np.log(rows[epochs]["temperature"]) for rows in scored])))
    numbers = epochs, miou, spreads[0], accuracy, spreads[1], temperature, len(scored)
    return Expectation(*numbers, one_drive=one_drive)


def _best(epochs: Sequence[int], logs: Sequence[dict[int, Row]]) -> int:
    """Return the number of epochs with the highest mean IoU, the fewest among equals."""
    return max(epochs, key=lambda epoch: np.mean([rows[epoch]["miou"] for rows in logs]))
