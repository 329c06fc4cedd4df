# SPDX-License-Identifier: MIT
"""Counting of pairs, compiled for the CPU."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from salsanext_cli.kernels import argument, compiled

TABLES = 4
"""Neighbours are often of one class: with as many tables, none waits for the one before it."""


def count_pairs(
    truth: npt.NDArray[np.integer], predicted: npt.NDArray[np.integer], class_count: int
) -> npt.NDArray[np.int64]:
    """Return how often each pair of ids occurs, (C, C) int64.

    Parameters
    ----------
    truth, predicted : (N,) integer
        Ids from 0 to C - 1; not checked.
    class_count : int
        C.
    """
    tables = np.zeros((TABLES, class_count, class_count), np.int64)
    count_into(tables, argument(truth, truth.dtype), argument(predicted, predicted.dtype))
    found: npt.NDArray[np.int64] = tables.sum(axis=0)
    return found


@compiled
def count_into(
    tables: npt.NDArray[np.int64],
    truth: npt.NDArray[np.integer],
    predicted: npt.NDArray[np.integer],
) -> None:
    """Count the pairs into the tables by turns."""
    for i in range(len(truth)):
        tables[i % TABLES, truth[i], predicted[i]] += 1
