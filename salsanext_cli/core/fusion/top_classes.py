# SPDX-License-Identifier: MIT
"""Softmax of points in a few bytes: the most probable classes."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.records import Float
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.npy import read_array, read_probabilities
from salsanext_cli.runs.results.paths import ScanFile, output_path

STORED = 3  # Classes that are stored of each point
LEVELS = 255  # Steps of a stored probability


def top_classes(softmax: Float) -> npt.NDArray[np.uint16]:
    """Return ``256 · class + probability · LEVELS`` of the most probable classes of points.

    They are (N, STORED) uint16 in descending order, of a softmax (N, C).
    """
    count = min(STORED, softmax.shape[1])
    classes = np.argpartition(-softmax, count - 1, axis=1)[:, :count]
    values = np.rint(np.take_along_axis(softmax, classes, 1) * LEVELS)
    packed: npt.NDArray[np.uint16] = (256 * classes + values).astype(np.uint16)
    return np.take_along_axis(packed, np.argsort(-values, axis=1, kind="stable"), 1)


def softmax_of(packed: npt.NDArray[np.uint16], classes: int) -> Float:
    """Return the softmax (N, classes) float32 of `top_classes`; other classes have 0."""
    softmax = np.zeros((len(packed), classes), np.float32)
    np.put_along_axis(
        softmax, (packed >> 8).astype(np.intp), (packed & 0xFF) / np.float32(LEVELS), 1
    )
    return softmax


def stored_softmax(out: Path, file: ScanFile, count: int, space: LabelSpace) -> Float:
    """Read the softmax (N, C) float32 of the points of a scan, or their votes, of `predict`."""
    path = output_path(out, file.sequence, "probabilities", file.stem)
    if present(path):
        return read_probabilities(path, count, space.class_count).astype(np.float32)
    votes = output_path(out, file.sequence, "votes", file.stem)
    packed = read_array(votes, "uint16", (count, min(STORED, space.class_count)))
    if (highest := (packed >> 8).max(initial=0)) >= space.class_count:
        expected = f"0 to {space.class_count - 1}, the classes of {space.name}"
        raise FormatError(votes, f"has class {highest}", expected, "predict again with --fuse")
    return softmax_of(packed, space.class_count)
