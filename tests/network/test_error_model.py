# SPDX-License-Identifier: MIT
"""Model of a label's error: its values, its form in a card, and cards that are damaged."""

import json
import math
from itertools import pairwise

import numba
import numpy as np
import pytest

from salsanext_cli import label_space, sensor
from salsanext_cli.errors import WeightsError
from salsanext_cli.network.card import KEY, WeightsCard
from salsanext_cli.network.error_model import ErrorModel, last_values


def layers(*sizes: int):
    random = np.random.default_rng(len(sizes))
    return [
        (random.normal(size=size).astype("f4"), random.normal(size=size[1]).astype("f4"))
        for size in pairwise(sizes)
    ]


def model() -> ErrorModel:
    return ErrorModel(("a", "b", "c"), layers(3, 4, 2, 1), {"auroc": 0.9})


def by_products(rows, given):
    for place, (weight, bias) in enumerate(given):
        rows = rows.astype("f8") @ weight + bias
        if place < len(given) - 1:
            rows = np.where(rows < 0, 0, rows)
    return rows[:, 0]


@pytest.mark.parametrize("threads", [2, 5])
@pytest.mark.parametrize("sizes", [(9, 16, 16, 1), (3, 1)])
@pytest.mark.parametrize("count", [0, 1, 255, 257, 1300])
def test_any_sizes_on_any_number_of_threads(count, sizes, threads, monkeypatch):
    monkeypatch.setattr("salsanext_cli.compiled.MIN_SLICE_ITEMS", 100)
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
    sure = ErrorModel(("a",), [(np.array([[1]], "f4"), np.array([0], "f4"))])
    found = sure.probability(np.array([[-1e9], [0], [1e9]], "f4"))
    assert found.tolist() == pytest.approx([0, 0.5, 1], abs=1e-9)
    assert ((found >= 0) & (found <= 1)).all()


def card(error: ErrorModel | None) -> WeightsCard:
    architecture = {"name": "salsanext", "class_count": 20}
    return WeightsCard(architecture, label_space(), sensor("hdl64"), error=error)


def test_a_card_keeps_it() -> None:
    wanted = model()
    metadata = card(wanted).to_metadata()
    found = WeightsCard.from_metadata(metadata, "w").error
    assert found is not None
    assert (found.features, found.scores) == (wanted.features, wanted.scores)
    features = np.random.default_rng(1).normal(size=(50, 3)).astype("f4")
    np.testing.assert_allclose(found.probability(features), wanted.probability(features), rtol=1e-5)
    assert WeightsCard.from_metadata(metadata, "w").to_metadata() == metadata
    # A card without one is what it was before there were any.
    assert "error" not in json.loads(card(None).to_metadata()[KEY])
    assert WeightsCard.from_metadata(card(None).to_metadata(), "w").error is None
    # It judges the weights that it was fitted to.
    assert card(wanted).changed("Quantised.").error is None


def test_damaged_ones_are_one_line() -> None:
    for damage in (
        lambda error: error.update(layers=[]),
        lambda error: error.update(features=["a"]),
        lambda error: error["layers"].pop(),
        lambda error: error["layers"][0][1].__setitem__(0, math.nan),
        lambda error: error["layers"][0][1].__setitem__(0, "x"),
        lambda error: error.pop("scores"),
    ):
        values = json.loads(card(model()).to_metadata()[KEY])
        damage(values["error"])
        with pytest.raises(WeightsError, match=r"^w · damaged metadata: ") as caught:
            WeightsCard.from_metadata({KEY: json.dumps(values)}, "w")
        assert "\n" not in str(caught.value)
        values["error"] = None
        with pytest.raises(WeightsError, match="error is no table"):
            WeightsCard.from_metadata({KEY: json.dumps(values)}, "w")


RISK = {"kind": "error", "threshold": 0.2, "at_most": 0.1, "confidence": None}
RISK |= {"scans": 12, "sequences": ["00"]}
LINE = {"slope": 1.0, "offset": 0.1, "deviation": 0.04}


@pytest.mark.parametrize(("part", "whole"), [("risk", RISK), ("accuracy", LINE)])
def test_numbers_that_a_statement_rests_on_are_all_there(part, whole) -> None:
    values = json.loads(card(None).to_metadata()[KEY])
    read = WeightsCard.from_metadata({KEY: json.dumps(values | {part: whole})}, "w")
    assert getattr(read, part) == whole
    broken = [{k: v for k, v in whole.items() if k != name} for name in whole]
    numbers = [name for name in whole if isinstance(whole[name], float)]
    broken += [whole | {name: value} for name in numbers for value in ("x", math.nan, None)]
    for each in broken:
        with pytest.raises(WeightsError, match="damaged metadata"):
            WeightsCard.from_metadata({KEY: json.dumps(values | {part: each})}, "w")
