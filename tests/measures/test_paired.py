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
    before, after = (scores(each, SPACE) for each in total)
    return after.accuracy - before.accuracy, after.iou_mean_present - before.iou_mean_present


def test_a_slow_loop_finds_the_same():
    pairs = runs(7)
    held = np.array([False, True, True, False])
    accuracy, mean, *classes = paired_differences(sums_of(pairs), held)
    assert (accuracy.difference, mean.difference) == pytest.approx(slow(pairs))
    random = np.random.default_rng(SEED)
    drawn = [random.integers(7, size=7) for _ in range(RESAMPLES)]
    found = np.percentile([slow([pairs[i] for i in each]) for each in drawn], (2.5, 97.5), axis=0)
    assert np.array([[accuracy.low, mean.low], [accuracy.high, mean.high]]) == pytest.approx(found)
    assert accuracy.low > 0
    assert classes[1].difference == pytest.approx(classes[1].after - classes[1].before)


def test_equal_runs_differ_by_nothing_and_few_scans_have_no_interval():
    pairs = [[pair[0], pair[0]] for pair in runs(MIN_SCANS)]
    held = np.array([False, True, True, False])
    assert paired_differences(sums_of(pairs), held)[0][2:] == (0, 0, 0)
    few = paired_differences(sums_of(pairs[1:]), held)[0]
    assert few.difference == 0
    assert math.isnan(few.low)


def pair(stem, turned, sums=None, trained_on=False):
    return ScanPair(ScanFile("08", stem, Path(stem)), np.array(turned), sums, trained_on)


def test_turned_classes_and_changed_scans():
    a = [[5, 0, 0, 0], [0, 3, 2, 0], [0, 0, 4, 0], [1, 0, 0, 0]]
    b = np.diag([5, 1, 1, 1])
    found = RunComparison(SPACE, [pair("a", a), pair("b", b)])
    assert found.turns() == [("car", "road", 2, 2 / 6), ("tree", "nothing", 1, 1 / 2)]
    assert [each.file.stem for each in found.most_changed()] == ["a"]
    data = found.to_dict()
    assert data["agreement"] == pytest.approx(10 / 13)
    assert [each["changed"] for each in data["changed_most"]] == pytest.approx([0.3])
    assert data["scores"] == data["by_distance"] == {}
