# SPDX-License-Identifier: MIT
"""Small perceptron, compiled for the CPU: faster than products of matrices of a few columns."""

from collections.abc import Sequence

import numpy as np

from salsanext_cli.compiled.kernels import argument, compiled, parallel_for_slices
from salsanext_cli.records import Float

BLOCK = 256
"""Rows computed together: with 16 values in a layer, they stay in the first cache."""


def last_values(rows: Float, layers: Sequence[tuple[Float, Float]]) -> Float:
    """Return the value of the last layer for each row; no bit depends on the number of threads.

    `rows` (N, F) float32; `layers`: weights and biases; between two layers, negative values become
    0. The first takes F values, the last returns one; this is not checked.

    Returns (N,) float32, NaN for rows with NaN.
    """
    rows = argument(rows, np.float32)
    given = tuple(
        (argument(weight, np.float32), argument(bias, np.float32)) for weight, bias in layers
    )
    found = np.empty(len(rows), np.float32)
    parallel_for_slices(lambda part: compute_rows(rows[part], given, found[part]), len(rows))
    return found


@compiled
def compute_rows(rows: Float, layers: tuple[tuple[Float, Float], ...], found: Float) -> None:
    """Write what `last_values` returns, block by block; a layer's values are (O, BLOCK)."""
    widest = rows.shape[1]
    for _, bias in layers:
        widest = max(widest, len(bias))
    before, after = np.zeros((2, widest, BLOCK), np.float32)
    for start in range(0, len(rows), BLOCK):
        count = min(BLOCK, len(rows) - start)
        for i in range(count):
            for k in range(rows.shape[1]):
                before[k, i] = rows[start + i, k]
        for number, (weight, bias) in enumerate(layers):
            for j in range(len(bias)):
                values = after[j]
                values[:] = bias[j]
                for k in range(len(weight)):
                    factor, column = weight[k, j], before[k]
                    for i in range(BLOCK):
                        values[i] += factor * column[i]
                if number < len(layers) - 1:
                    for i in range(BLOCK):
                        # Not `max`: NaN stays.
                        if values[i] < 0:
                            values[i] = 0
            before, after = after, before
        found[start : start + count] = before[0, :count]
