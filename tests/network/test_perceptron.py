# SPDX-License-Identifier: MIT
"""Small perceptrons, against products of matrices in float64."""

from itertools import pairwise

import numba
import numpy as np
import pytest

from salsanext_cli.network.error_model import last_values


def layers(*sizes: int):
    random = np.random.default_rng(len(sizes))
    return [
        (random.normal(size=size).astype("f4"), random.normal(size=size[1]).astype("f4"))
        for size in pairwise(sizes)
    ]


def by_products(rows, given):
    for place, (weight, bias) in enumerate(given):
        rows = rows.astype("f8") @ weight + bias
        if place < len(given) - 1:
            rows = np.where(rows < 0, 0, rows)
    return rows[:, 0]


@pytest.mark.parametrize("threads", [1, 2, 5])
@pytest.mark.parametrize("sizes", [(9, 16, 16, 1), (3, 1), (40, 5, 1), (2, 30, 1)])
@pytest.mark.parametrize("count", [0, 1, 255, 257, 1300])
def test_any_sizes_on_any_number_of_threads(count, sizes, threads, monkeypatch):
    monkeypatch.setattr("salsanext_cli.compiled.kernels.MIN_SLICE_ITEMS", 100)
    rows = np.random.default_rng(count).normal(size=(count, sizes[0])).astype("f4")
    rows[count // 2 : count // 2 + 1, -1] = np.nan
    given = layers(*sizes)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", 1)
    expected = last_values(rows, given)
    np.testing.assert_allclose(expected, by_products(rows, given), rtol=1e-4, atol=1e-5)
    assert np.isnan(expected).sum() == min(count, 1)
    monkeypatch.setitem(vars(numba.config), "NUMBA_NUM_THREADS", threads)
    for form in (rows, rows.astype("f8"), np.asfortranarray(rows), np.repeat(rows, 2, 0)[::2]):
        np.testing.assert_array_equal(last_values(form, given), expected)
