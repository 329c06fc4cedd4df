# SPDX-License-Identifier: MIT
"""Scores of classes, and of objects compared with a slow loop over all pairs of segments."""

import json
import math

import numpy as np
import pytest
import yaml
from evaluated import small_space
from hypothesis import given
from hypothesis import strategies as st
from sklearn import metrics

from salsanext_cli.measures.panoptic import MIN_SEGMENT_POINTS, count_segments, panoptic_quality
from salsanext_cli.measures.scores import confusion_matrix, scores

SPACE = small_space("unlabelled", "car", "on: road", "tree")
PAIRS = st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), max_size=60)


def split(pairs):
    return np.array(pairs, np.uint8).reshape(-1, 2).T


def of(pairs):
    return scores(confusion_matrix(*split(pairs), 4), SPACE)


@given(PAIRS.filter(len), PAIRS.filter(len))
def test_counts_are_those_of_scikit_learn_and_add_up(one, two):
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


def test_accuracy_and_means_of_points_predicted_unlabelled_and_of_absent_classes():
    result = of([(1, 1), (1, 0), (2, 2), (2, 3)])
    assert [c.iou for c in result.classes] == [0.5, 0.5, 0]
    assert result.accuracy == 0.5
    # The official accuracy divides by the points predicted as a scored class.
    assert result.accuracy_official == 2 / (3 + 1e-15)
    # An absent class that is predicted has an IoU of 0, which the mean of those present ignores.
    assert result.iou_mean_present == 0.5
    assert result.iou_mean_official == pytest.approx(1 / 3)


def test_the_mean_of_frequent_classes_is_that_of_at_least_500_points():
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
    assert text.splitlines()[:2] == [
        f"accuracy_mean: {2 / (4 + 1e-15)}",
        f"iou_car: {1 / (3 + 1e-15)}",
    ]
    assert f"{2 / (4 + 1e-15)}" != "0.5"
    assert list(yaml.safe_load(text)) == sorted(yaml.safe_load(text))
    assert yaml.safe_load(text)["iou_on: road"] == pytest.approx(0.5)
    assert yaml.safe_load(text)["iou_tree"] == 0


def test_json_holds_null_for_what_is_absent():
    plain = json.loads(json.dumps(of([(1, 1)]).to_dict(), allow_nan=False))
    car, road, _ = plain["classes"]
    assert (car["name"], car["iou"], road["iou"], plain["accuracy"]) == ("car", 1.0, None, 1.0)


SCENE = small_space("none", "road", "car", "person")
THINGS = np.array([False, False, True, True])


def slow_counts(truth, predicted):
    """Take the definition word by word: labels are pairs of class and instance."""
    points = [(t, p) for t, p in zip(truth, predicted, strict=True) if t[0] != 0]
    counts = np.zeros((4, 5))
    for c in (1, 2, 3):
        true = {t for t, _ in points if t[0] == c}
        found = {p for _, p in points if p[0] == c}
        matched = set()
        for t in true:
            for p in found:
                both = sum(pair == (t, p) for pair in points)
                either = sum(pair[0] == t or pair[1] == p for pair in points)
                if both / either > 0.5:
                    counts[c, :2] += both / either, 1
                    matched |= {("t", t), ("p", p)}
        size = {("t", t): sum(pair[0] == t for pair in points) for t in true}
        size |= {("p", p): sum(pair[1] == p for pair in points) for p in found}
        alone = [key for key, n in size.items() if key not in matched and n >= MIN_SEGMENT_POINTS]
        counts[c, 2:4] = sum(key[0] == "p" for key in alone), sum(key[0] == "t" for key in alone)
        counts[c, 4] = sum(instance > 0 for _, instance in true)
    return counts


def counts_of(truth, predicted):
    both = []
    for labels in (truth, predicted):
        train, instance = np.array(labels, np.int64).reshape(-1, 2).T
        both.append((train.astype(np.uint8), (train | instance << 16).astype(np.uint32)))
    return count_segments(*both, SCENE.scored)


@given(
    st.lists(
        st.tuples(*[st.tuples(st.integers(0, 3), st.integers(0, 2))] * 2, st.integers(1, 90)),
        max_size=9,
    )
)
def test_counts_are_those_of_the_definition(blocks):
    truth = [t for t, _, count in blocks for _ in range(count)]
    predicted = [p for _, p, count in blocks for _ in range(count)]
    np.testing.assert_allclose(counts_of(truth, predicted), slow_counts(truth, predicted))


def test_qualities_of_counts():
    """Three of four points of a car, all of a road, and a person that is called a car."""
    truth = [(2, 7)] * 100 + [(1, 0)] * 100 + [(3, 1)] * 60
    predicted = [(2, 1)] * 75 + [(1, 0)] * 125 + [(2, 2)] * 60
    found = panoptic_quality(counts_of(truth, predicted), SCENE, THINGS)
    car = found["classes"]["car"]
    assert car == {
        "pq": 0.5,
        "sq": 0.75,
        "rq": pytest.approx(2 / 3),
        "matches": 1,
        "false_alarms": 1,
        "misses": 0,
    }
    assert found["classes"]["road"]["pq"] == pytest.approx(0.8)
    assert found["classes"]["person"]["misses"] == 1
    assert found["things"]["pq"] == pytest.approx(0.25)
    assert found["all"]["pq"] == pytest.approx((0.5 + 0.8) / 3)
    assert panoptic_quality(counts_of([], []), SCENE, THINGS)["all"] == {"pq": 0, "sq": 0, "rq": 0}
