# SPDX-License-Identifier: MIT
"""Paired differences, against a slow loop over resamples and parts."""

import math

import numpy as np
import pytest
from evaluation_runs import small_space
from scipy.special import stdtrit

from salsanext_cli.core.measures.paired import (
    INTERVAL,
    MIN_PARTS,
    MIN_SCANS,
    PARTS,
    RESAMPLES,
    SEED,
    agreement,
    class_sums,
    consecutive_parts,
    score_differences,
    widening,
)
from salsanext_cli.core.measures.scores import confusion_matrix, scored_rows, scores

SPACE = small_space("nothing", "car", "road", "tree")


def confusions(count, *, noise=(0.5, 0.2)):
    """Return the confusions of some scans by two runs; trees are not in the truth."""
    random = np.random.default_rng(0)
    pairs = []
    for _ in range(count):
        truth = random.integers(0, 3, 400)
        pairs.append(
            [
                confusion_matrix(
                    truth, np.where(random.random(400) < p, random.integers(0, 4, 400), truth), 4
                )
                for p in noise
            ]
        )
    return pairs


def sums_of(pairs):
    return np.array([[class_sums(scored_rows(run, SPACE)) for run in pair] for pair in pairs])


def slow_changes(pairs):
    """Return the changes of accuracy, mean IoU and the IoU of cars by the measures of `eval`."""
    before, after = (scores(sum(pair[i] for pair in pairs), SPACE) for i in (0, 1))
    return (
        after.accuracy - before.accuracy,
        after.iou_mean_present - before.iou_mean_present,
        after.classes[0].iou - before.classes[0].iou,
    )


def test_changes_and_intervals_are_those_of_a_slow_loop():
    pairs = confusions(14)
    parts = np.repeat(np.arange(7), 2)
    found = score_differences(sums_of(pairs), parts)
    differences = (found.accuracy, found.iou_mean, found.classes[1])
    assert [d.change for d in differences] == pytest.approx(slow_changes(pairs))
    random = np.random.default_rng(SEED)
    resampled = []
    for _ in range(RESAMPLES):
        drawn = random.integers(7, size=7)
        resampled.append(
            slow_changes([pairs[i] for part in drawn for i in (2 * part, 2 * part + 1)])
        )
    changes = np.array(slow_changes(pairs))
    ends = changes + widening(7) * (np.percentile(resampled, INTERVAL, axis=0) - changes)
    assert [d.low for d in differences] == pytest.approx(ends[0])
    assert [d.high for d in differences] == pytest.approx(ends[1])
    assert all(d.is_clear for d in differences)
    assert set(found.classes) == {1, 2}
    assert found.parts == 7


def test_equal_runs_do_not_differ_clearly():
    pairs = [[pair[0], pair[0]] for pair in confusions(MIN_PARTS)]
    found = score_differences(sums_of(pairs), np.arange(MIN_PARTS))
    assert (found.accuracy.change, found.accuracy.low, found.accuracy.high) == (0, 0, 0)
    assert not found.accuracy.is_clear


def test_few_parts_have_no_interval():
    pairs = confusions(MIN_PARTS)
    found = score_differences(sums_of(pairs), np.arange(MIN_PARTS) % (MIN_PARTS - 1))
    assert found.accuracy.change > 0
    assert (found.accuracy.low, found.accuracy.high, found.accuracy.is_clear) == (None, None, False)
    nothing = [[np.zeros((4, 4), int)] * 2] * 6
    assert score_differences(sums_of(nothing), np.arange(6)) is None


@pytest.mark.parametrize("parts_of_trees", [1, MIN_PARTS - 1, MIN_PARTS])
def test_a_class_of_few_parts_has_no_interval(parts_of_trees):
    """A class in one part has the same change in every resample that has it."""
    pairs = []
    for number in range(20):
        truth = np.repeat([1, 2, 3 if number < parts_of_trees else 1], 50)
        worse = np.where((truth == 3) & (np.arange(150) % 2 > 0), 2, truth)
        pairs.append([confusion_matrix(truth, predicted, 4) for predicted in (worse, truth)])
    tree = score_differences(sums_of(pairs), np.arange(20)).classes[3]
    assert tree.change == 0.5
    assert (tree.low is None) == (parts_of_trees < MIN_PARTS)
    assert tree.is_clear == (parts_of_trees == MIN_PARTS)


@pytest.mark.parametrize("parts", [MIN_PARTS, 10, 20, 1000])
def test_the_widening_is_that_of_students_t(parts):
    expected = stdtrit(parts - 1, 0.975) / 1.96 * math.sqrt(parts / (parts - 1))
    assert widening(parts) == pytest.approx(expected, rel=3e-3)


@pytest.mark.parametrize("parts", [MIN_PARTS, 20])
def test_unchanged_scores_are_rarely_clear(parts):
    """The interval has 95 %: of 100 pairs of equally good runs, few differ clearly."""
    clear = 0
    for seed in range(100):
        random = np.random.default_rng(seed)
        truth = random.integers(1, 3, (parts, 200))
        sums = np.array(
            [
                [
                    class_sums(
                        confusion_matrix(row, np.where(random.random(200) < 0.3, 3 - row, row), 4)
                    )
                    for _ in range(2)
                ]
                for row in truth
            ]
        )
        clear += score_differences(sums, np.arange(parts)).accuracy.is_clear
    assert clear <= 8


@pytest.mark.parametrize(
    ("counts", "expected"),
    [
        ({"00": 3}, 1),
        ({"00": 2 * MIN_SCANS - 1}, 1),
        ({"00": 6 * MIN_SCANS}, 6),
        ({"00": 4000}, PARTS),
        ({"00": 1000, "01": 100, "02": 2}, 7 + 2 + 1),
        ({f"{n:02}": 2 for n in range(MIN_PARTS)}, MIN_PARTS),
    ],
)
def test_parts_are_consecutive_scans_of_one_sequence(counts, expected):
    sequences = [name for name, count in counts.items() for _ in range(count)]
    parts = consecutive_parts(sequences)
    assert parts.max() + 1 == expected
    assert (np.diff(parts) >= 0).all()
    for part in range(expected):
        assert len({sequences[i] for i in np.flatnonzero(parts == part)}) == 1


def test_the_agreement_is_over_points_that_a_run_labelled():
    turned = np.array([[5, 0, 0], [0, 3, 2], [1, 0, 4]])
    assert agreement(turned) == 7 / 10
    assert agreement(np.diag([5, 0, 0])) == 1
