# SPDX-License-Identifier: MIT
"""Probabilities and uncertainties of the points of a scan, checked for possible values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import FormatError
from salsanext_cli.formats.npy import read_array
from salsanext_cli.records import Float

ROUNDING = 0.01
"""Largest deviation of a sum over the classes from 1; that by float16 is a tenth of it."""


def read_probabilities(path: Path, count: int, class_count: int) -> npt.NDArray[np.float16]:
    """Read the softmax of a scan's points, (N, C) float16.

    Parameters
    ----------
    path : Path
        The `.npy` file.
    count, class_count : int
        N and C.

    Raises
    ------
    FormatError
        If the file cannot be read, is of another shape, or holds no probabilities.
    """
    softmax = read_array(path, np.float16, (count, class_count))
    sums = np.einsum("nc->n", softmax, dtype=np.float32)
    # NaN fails both comparisons.
    sound = (np.abs(sums - 1) < ROUNDING) & (softmax >= 0).all(axis=1)
    if not sound.all():
        raise FormatError(
            path,
            f"NaN or no probabilities at {_points(~sound)}",
            "numbers from 0 to 1 that add up to 1",
            "predict again with --probabilities",
        )
    return softmax


def read_uncertainty(path: Path, count: int) -> Float:
    """Read one kind of uncertainty of a scan's points, (N,) float32; NaN where there is none.

    Parameters
    ----------
    path : Path
        The `.npy` file.
    count : int
        N.

    Raises
    ------
    FormatError
        If the file cannot be read, is of another length, or holds no uncertainties.
    """
    values: Float = read_array(path, np.float32, (count,))
    unsound = (values < 0) | np.isinf(values)
    if unsound.any():
        raise FormatError(
            path,
            f"negative or infinite at {_points(unsound)}",
            "numbers from 0, or NaN for a point without a pixel",
            "run `salsanext uncertainty` again",
        )
    return values


def _points(chosen: npt.NDArray[np.bool_]) -> str:
    return f"{int(chosen.sum())} of {len(chosen)} points"
