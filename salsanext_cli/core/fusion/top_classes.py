# SPDX-License-Identifier: MIT
"""Softmax of points in a few bytes: the most probable classes."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Float

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
