# SPDX-License-Identifier: MIT
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sklearn.metrics import confusion_matrix

from salsanext_cli.measures.confusion import Confusion

C = 5
PAIRS = st.lists(st.tuples(st.integers(0, C - 1), st.integers(0, C - 1)), max_size=60)


def ids(*values: int) -> np.ndarray:
    return np.array(values, np.uint8)


def split(pairs: list[tuple[int, int]]) -> tuple[np.ndarray, np.ndarray]:
    truth, predicted = np.array(pairs, np.uint8).reshape(-1, 2).T
    return truth, predicted


@given(PAIRS.filter(len), PAIRS.filter(len))
def test_counts_are_those_of_scikit_learn_and_add_up(one, two):
    truth, predicted = split(one + two)
    expected = confusion_matrix(truth, predicted, labels=range(C))
    np.testing.assert_array_equal(Confusion(C).update(truth, predicted).matrix, expected)
    parts = [Confusion(C).update(*split(pairs)) for pairs in (one, two)]
    np.testing.assert_array_equal((parts[0] + parts[1]).matrix, expected)
    assert parts[0].matrix.sum() == len(one)
    np.testing.assert_array_equal(parts[0].update(*split(two)).matrix, expected)


def test_only_points_of_ignored_truth_are_left_out():
    confusion = Confusion(3).update(ids(1, 1, 0, 2), ids(1, 0, 1, 2))
    counted = confusion.counted(np.array([False, True, False]))
    assert counted.tolist() == [[0, 0, 0], [1, 1, 0], [0, 0, 0]]


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
def test_invalid_train_ids_are_refused_and_nothing_is_counted(truth, predicted, message):
    confusion = Confusion(C)
    with pytest.raises(ValueError, match=message):
        confusion.update(truth, predicted)
    assert not confusion.matrix.any()
