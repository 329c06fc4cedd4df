# SPDX-License-Identifier: MIT
"""Softmax of points in a few bytes each: the most probable classes."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float

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
