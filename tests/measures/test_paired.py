# SPDX-License-Identifier: MIT
"""Paired differences, against a slow loop over resamples and scans."""

import math
from pathlib import Path

import numpy as np
import pytest
from evaluated import small_space

from salsanext_cli.measures.paired import (
    MIN_SCANS,
    RESAMPLES,
    SEED,
    RunComparison,
    ScanPair,
    paired_differences,
)
from salsanext_cli.measures.scores import class_sums, confusion_matrix, scored_rows, scores
from salsanext_cli.results.paths import ScanFile

SPACE = small_space("nothing", "car", "road", "tree")


def runs(count, seed=0):
    """Return the confusions of some scans by two runs, of which the second is better."""
    random = np.random.default_rng(seed)
    pairs = []
    for _ in range(count):
        truth = random.integers(0, 3, 400)
        noise = [
            np.where(random.random(400) < p, random.integers(0, 4, 400), truth) for p in (0.5, 0.2)
        ]
        pairs.append([confusion_matrix(truth, predicted, 4) for predicted in noise])
    return pairs


def sums_of(pairs):
    return np.array([[class_sums(scored_rows(run, SPACE)) for run in pair] for pair in pairs])


def slow(pairs):
    total = [sum(pair[i] for pair in pairs) for i in (0, 1)]
    before, after = (scores(confusion, SPACE) for confusion in total)
    return after.accuracy - before.accuracy, after.iou_mean_present - before.iou_mean_present


PRESENT = np.array([False, True, True, False])


def test_intervals_are_those_of_a_slow_loop():
    pairs = runs(7)
    accuracy, mean, *classes = paired_differences(sums_of(pairs), PRESENT)
    assert (accuracy.difference, mean.difference) == pytest.approx(slow(pairs))
    random = np.random.default_rng(SEED)
    drawn = [random.integers(7, size=7) for _ in range(RESAMPLES)]
    of_draws = [slow([pairs[i] for i in draw]) for draw in drawn]
    expected = np.percentile(of_draws, (2.5, 97.5), axis=0)
    assert [(accuracy.low, mean.low), (accuracy.high, mean.high)] == pytest.approx(expected)
    assert accuracy.low > 0
    assert classes[1].difference == pytest.approx(classes[1].after - classes[1].before)


def test_equal_runs_differ_by_nothing_and_few_scans_have_no_interval():
    pairs = [[pair[0], pair[0]] for pair in runs(MIN_SCANS)]
    assert paired_differences(sums_of(pairs), PRESENT)[0][2:] == (0, 0, 0)
    few = paired_differences(sums_of(pairs[1:]), PRESENT)[0]
    assert few.difference == 0
    assert math.isnan(few.low)


def test_turned_classes_and_changed_scans():
    a = [[5, 0, 0, 0], [0, 3, 2, 0], [0, 0, 4, 0], [1, 0, 0, 0]]
    b = np.diag([5, 1, 1, 1])
    files = (ScanFile("08", stem, Path(stem)) for stem in "ab")
    compared = RunComparison(SPACE, [*map(ScanPair, files, np.array([a, b]))])
    assert compared.turns() == [("car", "road", 2, 2 / 6), ("tree", "nothing", 1, 1 / 2)]
    assert [pair.file.stem for pair in compared.most_changed()] == ["a"]
    data = compared.to_dict()
    assert data["agreement"] == pytest.approx(10 / 13)
    assert [scan["changed"] for scan in data["changed_most"]] == pytest.approx([0.3])
    assert data["scores"] == {}
