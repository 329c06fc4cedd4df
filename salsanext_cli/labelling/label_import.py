# SPDX-License-Identifier: MIT
"""Result of an import of labels."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import SalsanextError
from salsanext_cli.labelling.label_records import STAGE

LARGEST_CLASSES = 5
"""Classes that a result names."""


@dataclass(slots=True)
class LabelImport:
    """Result of an import."""

    space: LabelSpace  # Classes of the labels
    class_points: npt.NDArray[np.int64]  # (C,) int64: number of imported points by train id
    # Of each imported scan: `scan` as sequence/stem, its `files`, `scalar`, number of `points`,
    # `labelled`, `unlabelled`, `ambiguous`, `missing` and `unmatched`, as `EditedLabels` has them
    scans: list[dict[str, Any]] = field(default_factory=list)
    # What was not imported: `files`, `reason` and `code` of the error
    failures: list[dict[str, Any]] = field(default_factory=list)
    # Files that hold the first guess of `pick`, all of it; they are not imported
    unedited: list[str] = field(default_factory=list)
    kept: int = 0  # Number of scans of the data set that keep the labels they have, or have none
    # Scans of the data set whose label file is still the first guess, as sequence/stem
    first_guesses: list[str] = field(default_factory=list)

    def largest_classes(self) -> dict[str, float]:
        """Return the share of the labelled points, 0…1, of the largest classes, by name."""
        points = np.where(self.space.scored, self.class_points, 0)
        largest = np.argsort(-points, kind="stable")[:LARGEST_CLASSES]
        return {self.space.names[i]: float(points[i] / points.sum()) for i in largest if points[i]}

    def fail(self, files: Iterable[Path], error: SalsanextError) -> None:
        """Note files that are not imported."""
        named = {"files": [str(path) for path in files]}
        self.failures.append(named | {"reason": str(error), "code": error.code})

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON."""
        return {
            "stage": STAGE,
            "scans": self.scans,
            "failures": self.failures,
            "unedited": self.unedited,
            "kept": self.kept,
            "first_guesses": self.first_guesses,
            "largest_classes": self.largest_classes(),
        }
