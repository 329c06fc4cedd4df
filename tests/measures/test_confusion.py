# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import confusion_matrix, jaccard_score

from salsanext_cli.measures.confusion import Confusion

C = 5
PAIRS = st.lists(st.tuples(st.integers(0, C - 1), st.integers(0, C - 1)), max_size=60)
ALL = np.ones(C, bool)


def ids(*values: int) -> np.ndarray:
    return np.array(values, np.uint8)


def split(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    truth, predicted = np.array(pairs, np.uint8).reshape(-1, 2).T
    return truth, predicted


def of(pairs: list[tuple[int, int]]) -> Confusion:
    return Confusion(C).update(*split(pairs))


@given(PAIRS.filter(len))
def test_counts_are_scikit_learns(pairs):
    truth, predicted = split(pairs)
    expected = confusion_matrix(truth, predicted, labels=range(C))
    np.testing.assert_array_equal(of(pairs).matrix, expected)


@given(PAIRS.filter(len))
def test_iou_is_scikit_learns_where_a_class_occurs(pairs):
    truth, predicted = split(pairs)
    iou = of(pairs).iou(ALL)
    occurs = np.isin(np.arange(C), np.concatenate([truth, predicted]))
    np.testing.assert_array_equal(np.isnan(iou), ~occurs)
    expected = jaccard_score(truth, predicted, labels=range(C), average=None, zero_division=0)
    np.testing.assert_allclose(iou[occurs], expected[occurs], rtol=1e-15)


@given(PAIRS, PAIRS)
def test_adding_is_pooling(one, two):
    assert of(one) + of(two) == of(one + two) == of(one).update(*split(two))
    assert of(one).total == len(one)
    assert (of(one) == of(two)) == (sorted(one) == sorted(two))


def test_only_points_of_ignored_truth_are_left_out():
    confusion = Confusion(4).update(ids(1, 1, 0, 2), ids(1, 0, 1, 2))
    iou = confusion.iou()
    # Half of class 1 is predicted unlabelled, a miss; the unlabelled point called 1 is no error.
    np.testing.assert_array_equal(iou, [np.nan, 0.5, 1.0, np.nan])


def test_an_ignored_class_that_is_predicted_has_no_iou_but_costs():
    confusion = Confusion(3).update(ids(1, 1, 1, 1), ids(1, 2, 2, 2))
    iou = confusion.iou(np.array([False, True, False]))
    np.testing.assert_array_equal(iou, [np.nan, 0.25, np.nan])


def test_a_class_never_seen_is_nan_and_a_class_never_found_is_zero():
    iou = Confusion(4).update(ids(1, 1, 2), ids(1, 1, 1)).iou()
    assert iou[2] == 0
    assert np.isnan(iou[3])


def test_images_count_like_points():
    rng = np.random.default_rng(7)
    truth, predicted = rng.integers(0, C, (2, 8, 16)).astype(np.uint8)
    images = Confusion(C).update(truth, predicted)
    assert images == Confusion(C).update(truth.ravel(), predicted.ravel())


@pytest.mark.parametrize("dtype", [np.uint8, np.int32, np.int64, np.uint64])
def test_any_integer_will_do(dtype):
    confusion = Confusion(255).update(np.array([254], dtype), np.array([253], np.uint8))
    assert confusion.matrix[254, 253] == 1


def test_a_sum_does_not_share_counts():
    one = Confusion(2).update(ids(1), ids(1))
    total = one + Confusion(2)
    total.update(ids(1), ids(1))
    assert one.total == 1


@pytest.mark.parametrize(
    ("truth", "predicted", "message"),
    [
        (ids(1, 2), ids(1), "shape"),
        (ids(1, 2).reshape(1, 2), ids(1, 2), "shape"),
        (ids(1, 5), ids(1, 2), "truth: 1…5, not 0…4"),
        (ids(1, 2), ids(1, 255), "predicted: 1…255"),
        (np.array([-1]), ids(1), "truth: -1"),
        (np.array([1.0]), ids(1), "truth: float64"),
    ],
)
def test_what_is_not_train_ids_is_refused_and_nothing_is_counted(truth, predicted, message):
    confusion = Confusion(C)
    with pytest.raises(ValueError, match=message):
        confusion.update(truth, predicted)
    assert confusion.total == 0


def test_counts_of_different_classes_do_not_add():
    with pytest.raises(ValueError, match="3 and 4"):
        Confusion(3) + Confusion(4)
    with pytest.raises(TypeError):
        Confusion(3) + 1


@pytest.mark.parametrize(
    "matrix", [np.zeros((2, 3), int), np.zeros((3, 3)), np.full((3, 3), -1)], ids=str
)
def test_only_counts_make_a_matrix(matrix):
    with pytest.raises(ValueError, match="matrix"):
        Confusion(3, matrix)


def test_a_confusion_needs_classes_and_a_fitting_mask():
    with pytest.raises(ValueError, match="class_count"):
        Confusion(0)
    with pytest.raises(ValueError, match="scored"):
        Confusion(3).iou(np.array([True, False]))
