# SPDX-License-Identifier: MIT
"""Fit of a novelty model, beside the distances of a slow clear loop."""

import numpy as np
import pytest

from salsanext_cli.network.novelty_model import NoveltyModel
from salsanext_cli.training.tuning.novelty import MIN_POINTS, RIDGE, ClassMoments

RANDOM = np.random.default_rng(2)
MIXED = RANDOM.normal(size=(4, 4))


def points(centre, count):
    return (RANDOM.normal(size=(count, 4)) @ MIXED + centre).astype(np.float32)


def test_the_distance_is_mahalanobis_to_the_nearest_class_of_enough_points():
    groups = {1: points(0, 3000), 2: points(5, 2000), 5: points(-9, MIN_POINTS - 1)}
    moments = ClassMoments(6)
    for place, features in groups.items():
        for part in np.array_split(features, 3):
            moments.add(part, np.full(len(part), place, np.uint8))
    model = moments.model()
    known = {place: groups[place].astype(np.float64) for place in (1, 2)}
    inner = np.concatenate([each - each.mean(axis=0) for each in known.values()])
    covariance = inner.T @ inner / len(inner)
    inverse = np.linalg.inv(covariance + RIDGE * np.trace(covariance) / 4 * np.eye(4))
    asked = np.concatenate([points(0, 5), points(5, 5), points(-9, 5)])
    slow = []
    for x in asked:
        offsets = [x - each.mean(axis=0) for each in known.values()]
        slow.append(min(np.sqrt(offset @ inverse @ offset) for offset in offsets))
    np.testing.assert_allclose(model.distance(asked), slow, rtol=1e-3)
    again = NoveltyModel.from_dict(model.to_dict())
    np.testing.assert_allclose(again.distance(asked), slow, rtol=1e-3)


def test_too_few_points_and_constant_features():
    moments = ClassMoments(3)
    assert moments.model() is None
    moments.add(np.ones((MIN_POINTS, 2), np.float32), np.ones(MIN_POINTS, np.uint8))
    distance = moments.model().distance(np.array([[1, 1], [1, 2]], np.float32))
    assert distance[0] < 1e-3 < distance[1]
    assert np.isfinite(distance).all()


@pytest.mark.parametrize(
    "change",
    [
        {"centres": []},
        {"centres": [[1.0, 2.0, 3.0]]},
        {"whitening": [[1.0, float("nan")], [0.0, 1.0]]},
    ],
)
def test_a_damaged_model_is_refused(change):
    whole = NoveltyModel(np.eye(2, dtype=np.float32), np.ones((1, 2), np.float32)).to_dict()
    with pytest.raises(ValueError, match="novelty model"):
        NoveltyModel.from_dict({**whole, **change})
