# SPDX-License-Identifier: MIT
"""Model of a label's error: its values, its form in a card, and cards that are damaged."""

import json
import math

import numpy as np
import pytest

from salsanext_cli import label_space, sensor
from salsanext_cli.errors import WeightsError
from salsanext_cli.network.card import KEY, WeightsCard
from salsanext_cli.network.error_model import ErrorModel


def model(seed: int = 0) -> ErrorModel:
    random = np.random.default_rng(seed)
    sizes = ((3, 4), (4, 2), (2, 1))
    layers = [
        (random.normal(size=size).astype("f4"), random.normal(size=size[1]).astype("f4"))
        for size in sizes
    ]
    return ErrorModel(("a", "b", "c"), layers, {"auroc": 0.9})


def test_a_probability_is_that_of_a_slow_loop() -> None:
    found, features = model(), np.random.default_rng(1).normal(size=(7, 3)).astype("f4")
    features[3, 1] = np.nan
    for row, probability in zip(features, found.probability(features), strict=True):
        values = row.tolist()
        for place, (weight, bias) in enumerate(found.layers):
            values = [
                sum(v * w for v, w in zip(values, weight[:, j].tolist(), strict=True)) + bias[j]
                for j in range(len(bias))
            ]
            if place < 2:
                values = [v if math.isnan(v) else max(v, 0) for v in values]
        assert probability == pytest.approx(1 / (1 + math.exp(-values[0])), abs=1e-6, nan_ok=True)
    assert np.isnan(found.probability(features)[3])


def test_certain_values_stay_between_0_and_1() -> None:
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


@pytest.mark.parametrize(
    "damage",
    [
        lambda error: error.update(layers=[]),
        lambda error: error.update(features=["a"]),
        lambda error: error["layers"].pop(),
        lambda error: error["layers"][0][1].__setitem__(0, math.nan),
        lambda error: error["layers"][0][1].__setitem__(0, "x"),
        lambda error: error.pop("scores"),
    ],
)
def test_damaged_ones_are_one_line(damage) -> None:
    values = json.loads(card(model()).to_metadata()[KEY])
    damage(values["error"])
    with pytest.raises(WeightsError, match=r"^w · damaged metadata: ") as caught:
        WeightsCard.from_metadata({KEY: json.dumps(values)}, "w")
    assert "\n" not in str(caught.value)
    values["error"] = None
    with pytest.raises(WeightsError, match="error is no table"):
        WeightsCard.from_metadata({KEY: json.dumps(values)}, "w")
