# SPDX-License-Identifier: MIT
"""The error model is a small network of its own."""

import numba
import numpy as np
import pytest
from error_models import layers, model

from salsanext_cli.core.network.error_model import ErrorModel, last_values


def by_products(rows, given):
    for place, (weight, bias) in enumerate(given):
        rows = rows.astype("f8") @ weight + bias
        if place < len(given) - 1:
            rows = np.where(rows < 0, 0, rows)
    return rows[:, 0]


@pytest.mark.usefixtures("small_slices")
@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("sizes", [(9, 16, 16, 1), (3, 1)])
@pytest.mark.parametrize("count", [0, 1, 255, 257, 1300])
def test_any_sizes_on_any_number_of_threads(count, sizes, threads, monkeypatch):
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


def test_a_probability_is_the_logistic_function_of_the_last_value() -> None:
    found, features = model(), np.random.default_rng(1).normal(size=(7, 3)).astype("f4")
    expected = 1 / (1 + np.exp(-by_products(features, found.layers)))
    np.testing.assert_allclose(found.probability(features), expected, atol=1e-6)
    sure = ErrorModel(features=("a",), layers=[(np.array([[1]], "f4"), np.array([0], "f4"))])
    found = sure.probability(np.array([[-1e9], [0], [1e9]], "f4"))
    assert found.tolist() == pytest.approx([0, 0.5, 1], abs=1e-9)
    assert ((found >= 0) & (found <= 1)).all()
