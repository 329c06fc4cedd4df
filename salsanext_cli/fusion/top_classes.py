# SPDX-License-Identifier: MIT
"""Softmax of points in a few bytes each: the most probable classes."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import FormatError
from salsanext_cli.files.reading import present
from salsanext_cli.formats.npy import read_array, read_probabilities
from salsanext_cli.records import Float
from salsanext_cli.results.paths import ScanFile, output_path

KEPT = 3  # Classes that are kept of each point
LEVELS = 255  # Steps of a kept probability


def top_classes(softmax: Float) -> npt.NDArray[np.uint16]:
    """Return the `KEPT` most probable classes of a softmax (N, C): (N, KEPT) uint16, descending.

    Each is ``256 · class + probability · LEVELS``.
    """
    kept = min(KEPT, softmax.shape[1])
    classes = np.argpartition(-softmax, kept - 1, axis=1)[:, :kept]
    values = np.rint(np.take_along_axis(softmax, classes, 1) * LEVELS)
    packed: npt.NDArray[np.uint16] = (256 * classes + values).astype(np.uint16)
    return np.take_along_axis(packed, np.argsort(-values, axis=1, kind="stable"), 1)


def softmax_of(packed: npt.NDArray[np.uint16], classes: int) -> Float:
    """Return the softmax (N, classes) float32 of what `top_classes` kept; others are 0."""
    softmax = np.zeros((len(packed), classes), np.float32)
    np.put_along_axis(
        softmax, (packed >> 8).astype(np.intp), (packed & 0xFF) / np.float32(LEVELS), 1
    )
    return softmax


def kept_softmax(out: Path, file: ScanFile, count: int, space: LabelSpace) -> Float:
    """Read the softmax (N, C) float32 that `predict` kept of a scan's points, or its votes."""
    path = output_path(out, file.sequence, "probabilities", file.stem)
    if present(path):
        return read_probabilities(path, count, space.class_count).astype(np.float32)
    votes = output_path(out, file.sequence, "votes", file.stem)
    kept = min(KEPT, space.class_count)
    packed = read_array(votes, "uint16", (count, kept))
    if (packed >> 8).max(initial=0) >= space.class_count:
        found = f"class {(packed >> 8).max()}"
        expected = f"0 … {space.class_count - 1}, the classes of {space.name}"
        raise FormatError(votes, found, expected, "predict again with --fuse")
    return softmax_of(packed, space.class_count)
