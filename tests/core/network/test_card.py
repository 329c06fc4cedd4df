# SPDX-License-Identifier: MIT
"""The card of weights comes back from its record, or names what is wrong."""

import json
import math

import numpy as np
import pytest
from error_models import model
from scans import refused

from salsanext_cli import label_space, sensor
from salsanext_cli.core.errors import WeightsError
from salsanext_cli.core.network.card import KEY, WeightsCard
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.network.tuned_settings import KEY_OF
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.sensors.sensor import FittedView


def card(error: ErrorModel | None) -> WeightsCard:
    architecture = {"name": "salsanext", "class_count": 20}
    return WeightsCard(architecture, label_space(), sensor("hdl64"), error=error)


def test_a_card_keeps_it() -> None:
    wanted = model()
    metadata = card(wanted).to_metadata()
    found = WeightsCard.from_metadata(metadata, "w").error
    assert (found.features, found.scores) == (wanted.features, wanted.scores)
    features = np.random.default_rng(1).normal(size=(50, 3)).astype("f4")
    np.testing.assert_allclose(found.probability(features), wanted.probability(features), rtol=1e-5)
    assert WeightsCard.from_metadata(metadata, "w").to_metadata() == metadata
    # A card without one is what it was before there were any.
    assert "error" not in json.loads(card(None).to_metadata()[KEY])
    assert WeightsCard.from_metadata(card(None).to_metadata(), "w").error is None


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
        for error in (values["error"], None):
            with refused(WeightsError, "w"):
                WeightsCard.from_metadata({KEY: json.dumps(values | {"error": error})}, "w")


RISK = {"kind": "error", "threshold": 0.2, "at_most": 0.1, "confidence": None}
RISK |= {"scans": 12, "sequences": ["00"]}
LINE = {"slope": 1.0, "offset": 0.1, "deviation": 0.04}


@pytest.mark.parametrize(("part", "whole"), [("risk", RISK), ("accuracy", LINE)])
def test_numbers_that_a_statement_rests_on_are_all_there(part, whole) -> None:
    values = json.loads(card(None).to_metadata()[KEY])
    read = WeightsCard.from_metadata({KEY: json.dumps(values | {part: whole})}, "w")
    assert {name: plain(getattr(getattr(read, part), name)) for name in whole} == whole
    broken = [{k: v for k, v in whole.items() if k != name} for name in whole]
    numbers = [name for name in whole if isinstance(whole[name], float)]
    broken += [whole | {name: value} for name in numbers for value in ("x", math.nan, None)]
    for each in broken:
        with pytest.raises(WeightsError):
            WeightsCard.from_metadata({KEY: json.dumps(values | {part: each})}, "w")


def test_thresholds_with_the_keys_of_early_versions() -> None:
    """Fields of view are read; thresholds of classes would accept labels that they rejected."""
    values = json.loads(card(None).to_metadata()[KEY])

    def read(**risk) -> WeightsCard:
        return WeightsCard.from_metadata({KEY: json.dumps(values | {"risk": RISK | risk})}, "w")

    views = [FittedView.from_sensor(sensor(name)) for name in ("hdl64", "hdl64-512")]
    first, second = map(plain, views)
    assert read(view=first, other_views=[second]).risk.views == tuple(views)
    assert read(view=None, other_views=[], classes={}).risk == read().risk
    early = {"--min-range": 1.0, "--sensor": {"name": "hdl64", "width": 512}}
    later = {"--min-range": 1.0, "--sensor": {"name": "hdl64"}, "--width": 512}
    assert read(settings=early).risk.settings == later
    assert {*later} <= {*KEY_OF.values()}
    for risk in ({"classes": {"car": 0.1}}, {"view": 5}):
        with pytest.raises(WeightsError):
            read(**risk)
    for other in ("x", 5, [RISK]):
        with pytest.raises(WeightsError):
            WeightsCard.from_metadata({KEY: json.dumps(values | {"risk": other})}, "w")
