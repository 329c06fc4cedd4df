# SPDX-License-Identifier: MIT
"""Scores of classes, compared with scikit-learn and with counting one by one."""

import math

import numpy as np
import pytest
import yaml
from evaluation_runs import small_space
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.measures.scores import confusion_matrix, scores

SPACE = small_space("unlabelled", "car", "on: road", "tree")
PAIRS = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=60)


def split(pairs):
    return np.array(pairs, np.uint8).reshape(-1, 2).T


def of(pairs):
    return scores(confusion_matrix(*split(pairs), 4), SPACE)


@given(PAIRS.filter(len), PAIRS.filter(len))
def test_counts_are_those_of_scikit_learn_and_add_up(one, two):
    from sklearn import metrics  # It takes a second.

    expected = metrics.confusion_matrix(*split(one + two), labels=range(4))
    np.testing.assert_array_equal(confusion_matrix(*split(one + two), 4), expected)
    parts = [confusion_matrix(*split(pairs), 4) for pairs in (one, two)]
    np.testing.assert_array_equal(parts[0] + parts[1], expected)


@pytest.mark.parametrize("predicted", [[1, 2, 3], [1, 255], [1, -1]])
def test_invalid_train_ids_are_refused(predicted):
    with pytest.raises(ValueError, match=r"broadcast|invalid entry"):
        confusion_matrix(np.array([1, 2]), np.array(predicted), 4)


@given(PAIRS)
def test_scores_follow_from_counting_one_by_one(pairs):
    result = of(pairs)
    labelled = [(t, p) for t, p in pairs if t != 0]
    ious = []
    for c in result.classes:
        both = sum(t == p == c.train_id for t, p in labelled)
        either = sum(c.train_id in pair for pair in labelled)
        assert c.points == sum(t == c.train_id for t, _ in labelled)
        assert c.predicted == sum(p == c.train_id for _, p in labelled)
        assert _same(c.iou, both, either)
        assert _same(c.precision, both, c.predicted)
        assert _same(c.recall, both, c.points)
        ious.append(both / either if either else 0.0)
    right = sum(t == p for t, p in labelled)
    assert result.points == len(labelled)
    assert labelled or result.accuracy_official == 0
    assert math.isnan(result.iou_mean_frequent)
    assert _same(result.accuracy, right, len(labelled))
    assert result.iou_mean_official == pytest.approx(sum(ious) / 3, abs=1e-12)
    present = [iou for iou, c in zip(ious, result.classes, strict=True) if c.points]
    assert _same(result.iou_mean_present, sum(present), len(present))


def _same(share, part, whole):
    return share == pytest.approx(part / whole, abs=1e-12) if whole else math.isnan(share)


def test_accuracy_and_means_of_unlabelled_points_and_of_absent_and_frequent_classes():
    result = of([(1, 1), (1, 0), (2, 2), (2, 3)])
    assert [c.iou for c in result.classes] == [0.5, 0.5, 0]
    assert result.accuracy == 0.5
    # The official accuracy divides by the points predicted as a scored class.
    assert result.accuracy_official == 2 / (3 + 1e-15)
    # An absent class that is predicted has an IoU of 0, which the mean of those present ignores.
    assert result.iou_mean_present == 0.5
    assert result.iou_mean_official == pytest.approx(1 / 3)
    # The tree has one point too few.
    truth, predicted = np.repeat([1, 2, 2, 3], [500, 500, 250, 499]), np.repeat(1, 1749)
    predicted[750:1000], predicted[1000:] = 2, 3
    result = scores(confusion_matrix(truth, predicted, 4), SPACE)
    assert [c.points for c in result.classes] == [500, 750, 499]
    assert [c.iou for c in result.classes] == [500 / 750, 250 / 750, 499 / 749]
    assert result.iou_mean_frequent == pytest.approx(1 / 2)
    assert result.iou_mean_present == pytest.approx((1 + 499 / 749) / 3)


def test_the_official_text_is_sorted_yaml_with_every_digit():
    text = of([(1, 1), (1, 2), (1, 3), (2, 2)]).official_yaml()
    # 10⁻¹⁵ in the denominator shows where points are few.
    first = [f"accuracy_mean: {2 / (4 + 1e-15)}", f"iou_car: {1 / (3 + 1e-15)}"]
    assert text.splitlines()[:2] == first
    assert f"{2 / (4 + 1e-15)}" != "0.5"
    assert list(yaml.safe_load(text)) == sorted(yaml.safe_load(text))
    assert yaml.safe_load(text)["iou_on: road"] == pytest.approx(0.5)
    assert yaml.safe_load(text)["iou_tree"] == 0
