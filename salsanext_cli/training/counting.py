# SPDX-License-Identifier: MIT
"""Look at every label of the training data once: all usable, and how common is each class."""

from __future__ import annotations

from collections.abc import Sequence

import joblib
import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import LabelSpace
from salsanext_cli.errors import LabelError, TrainingError
from salsanext_cli.formats.layout import ScanFile
from salsanext_cli.sensors import Sensor
from salsanext_cli.training.dataset import read_labelled


def require_labels(files: Sequence[ScanFile]) -> None:
    """Raise `LabelError` naming the first scan without a label file."""
    missing = [file for file in files if not file.label_path.is_file()]
    if missing:
        raise LabelError(
            missing[0].label_path,
            f"no such file, nor for {len(missing) - 1} other scans" * (len(missing) > 1)
            or "no such file",
            "a label file for every scan of the split",
        )


def count_classes(
    files: Sequence[ScanFile], space: LabelSpace, sensor: Sensor, jobs: int = 1
) -> npt.NDArray[np.int64]:
    """Count the points of every class, (C,) int64, reading every scan with its labels.

    Raises
    ------
    FormatError, LabelError
        If any scan could not be trained on.
    TrainingError
        If no point is of a class that counts.
    """

    def count(file: ScanFile) -> npt.NDArray[np.int64]:
        _, labels = read_labelled(file, space, sensor)
        return np.bincount(labels, minlength=space.class_count).astype(np.int64)

    # Threads do: reading and counting leave the interpreter's lock alone.
    found = joblib.Parallel(jobs, backend="threading")(joblib.delayed(count)(f) for f in files)
    counts: npt.NDArray[np.int64] = np.sum(found, axis=0)
    if not counts[space.scored].any():
        raise TrainingError(
            files[0].label_path.parent,
            f"none of {counts.sum()} points is of a class that counts",
            f"labels of {space.name}",
        )
    return counts
