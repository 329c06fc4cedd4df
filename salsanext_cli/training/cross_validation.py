# SPDX-License-Identifier: MIT
"""Cross-validation of a training: its folds, the number of epochs that it chooses, its scores."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.training.log import Row


def folds(files: Sequence[ScanFile], count: int) -> list[list[ScanFile]]:
    """Divide scans into folds, each to be left out once.

    Scans of one place are much alike, so that a fold takes whole sequences, the longest first, each
    to the fold with the fewest scans so far. Of fewer sequences than folds it takes neighbours.

    Parameters
    ----------
    files : sequence of ScanFile
        In order of sequences.
    count : int
        Number of folds; no more than there are scans.
    """
    sequences = [list(members) for _, members in groupby(files, lambda file: file.sequence)]
    if len(sequences) < count:
        parts = np.array_split(np.arange(len(files)), min(count, len(files)))
        return [[files[i] for i in part] for part in parts]
    found: list[list[ScanFile]] = [[] for _ in range(count)]
    for sequence in sorted(sequences, key=len, reverse=True):
        min(found, key=len).extend(sequence)
    return [sorted(fold, key=files.index) for fold in found]


@dataclass(frozen=True, slots=True)
class Expectation:
    """Scores on scans left out, which tell what to expect of new ones.

    Attributes
    ----------
    epochs : int
        Number of epochs with the highest mean IoU, over the folds.
    miou, accuracy : float
        Mean over the folds after so many epochs.
    miou_spread, accuracy_spread : float
        Standard deviations over the folds, with one degree of freedom less.
    temperature : float
        Geometric mean of those fitted on the scans left out.
    folds : int
        Number of folds.
    """

    epochs: int
    miou: float
    miou_spread: float
    accuracy: float
    accuracy_spread: float
    temperature: float
    folds: int

    def scores(self) -> dict[str, float]:
        """Return what the card of weights tells."""
        return {
            "folds": self.folds,
            "miou": self.miou,
            "miou_spread": self.miou_spread,
            "accuracy": self.accuracy,
            "accuracy_spread": self.accuracy_spread,
        }


def expectation(logs: Sequence[Sequence[Row]]) -> Expectation | None:
    """Choose the number of epochs by the logs of the folds, None if no fold could be scored.

    Folds whose scans have no class that counts do not count; of equal means the fewest epochs win.
    """
    validated = [
        {int(row["epoch"]): row for row in rows if row.get("miou", np.nan) == row.get("miou")}
        for rows in logs
    ]
    scored = [rows for rows in validated if rows]
    if not scored:
        return None
    common = sorted(set.intersection(*(set(rows) for rows in scored)))
    epochs = max(common, key=lambda epoch: np.mean([rows[epoch]["miou"] for rows in scored]))
    miou, accuracy, temperature = (
        np.array([rows[epochs][key] for rows in scored])
        for key in ("miou", "accuracy", "temperature")
    )
    spread = 1 if len(scored) > 1 else 0
    return Expectation(
        epochs,
        float(miou.mean()),
        float(miou.std(ddof=spread)),
        float(accuracy.mean()),
        float(accuracy.std(ddof=spread)),
        float(np.exp(np.log(temperature).mean())),
        len(scored),
    )
