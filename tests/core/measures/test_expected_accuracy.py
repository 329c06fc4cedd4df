# SPDX-License-Identifier: MIT
"""Estimated accuracy without labels: the interval, and the scans that it does not cover."""

import json
import re
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.measures.expected_accuracy import WITHHELD_FOR, expected_accuracy
from salsanext_cli.core.network.card import DEVIATIONS, AccuracyLine
from salsanext_cli.io.weights.card_file import default_weights, read_card

LINE = AccuracyLine(1.0, 0.0, 0.05)
SAFETY = Path(__file__).parents[3] / "docs/experiments/guarantee.md"
FIGURES = Path(__file__).parents[3] / "docs/figures.json"
SHARES = st.floats(0, 1)
ALL_CLASSES = 1  # Number of a table on that page
COARSE = 2


def judged_drives(number: int) -> np.ndarray:
    """Return a table of the docs: confidence, estimated and right (3, drives), in %."""
    tables = SAFETY.read_text().split("| confidence | estimated | right |")
    table = tables[number].split("\n\n")[0]
    columns = zip(*(line.split("|")[2:5] for line in table.splitlines()[2:]), strict=True)
    return np.array(
        [[float(n) for n in re.findall(r"[\d.]+", " ".join(cells))] for cells in columns]
    )


@pytest.mark.parametrize("number", [ALL_CLASSES, COARSE])
def test_the_line_of_the_weights_is_that_of_the_docs(number):
    confidences, expected, _ = judged_drives(number)
    line = read_card(default_weights()).accuracy
    for confidence, stated in zip(confidences, expected, strict=True):
        estimate = expected_accuracy(line, {"a": confidence / 100}, {})
        assert 100 * estimate.accuracy == pytest.approx(stated, abs=0.1)


def test_the_deviation_of_the_weights_is_that_of_the_docs():
    _, expected, right = judged_drives(ALL_CLASSES)
    line = read_card(default_weights()).accuracy
    misses = expected - right
    assert line.deviation == pytest.approx(np.sqrt(np.mean(misses**2)) / 100, abs=1e-3)


def test_the_interval_holds_for_as_many_drives_as_the_docs_state():
    _, estimated, right = judged_drives(ALL_CLASSES)
    inside = np.abs(estimated - right) <= 100 * read_card(default_weights()).accuracy.margin
    stored = json.loads(FIGURES.read_text())["estimates"]
    assert (len(inside), sum(inside)) == (int(stored["drives"]), int(stored["inside"]))
    assert sum(inside) >= 0.9 * len(inside)


def test_the_interval_holds_in_coarse_classes():
    _, estimated, right = judged_drives(COARSE)
    misses = np.abs(estimated - right)
    assert len(misses) == 12
    assert misses.max() <= 100 * read_card(default_weights()).accuracy.margin
    assert np.sqrt(np.mean(misses**2)) == pytest.approx(1.6, abs=0.05)


def test_lines_of_early_weights_have_an_interval_of_some_deviations():
    early = AccuracyLine(1.0, 0.0, 0.04)
    assert early.margin == pytest.approx(DEVIATIONS * 0.04)
    assert AccuracyLine(1.0, 0.0, 0.04, half_width=0.1).margin == 0.1
    assert "half_width" not in early.to_dict()


@given(st.dictionaries(st.text(max_size=3), SHARES, min_size=1), SHARES)
def test_the_estimate_is_a_share_within_its_interval(confidences, deviation):
    line = AccuracyLine(1e3, -3.0, deviation)
    estimate = expected_accuracy(line, confidences, {})
    low, high = estimate.interval
    assert 0 <= low <= estimate.accuracy <= high <= 1
    assert estimate.scans == len(confidences)


def test_the_mean_confidence_of_usual_scans_of_one_sensor_decides():
    confidences = {"a": 0.8, "b": 0.6, "c": 0.1}
    estimate = expected_accuracy(LINE, confidences, {"tilted": ["c"], "part-of-circle": ["a"]})
    assert estimate.accuracy == pytest.approx(0.7, abs=1e-4)
    assert estimate.interval == pytest.approx((0.525, 0.875), abs=1e-4)
    assert (estimate.scans, estimate.withheld) == (2, {"tilted": 1})
    estimate = expected_accuracy(LINE, {"a": 0.8, "b": 0.8}, {"mixed-sensors": ["b"]})
    assert (estimate.accuracy, estimate.withheld) == (None, {"mixed-sensors": 1})
    assert expected_accuracy(None, {"a": 0.8}, {}) is None
    assert expected_accuracy(LINE, {}, {}) is None


@pytest.mark.parametrize("code", WITHHELD_FOR)
def test_nothing_is_estimated_for_scans_unlike_the_labelled_drives(code):
    estimate = expected_accuracy(LINE, {"a": 0.8}, {code: ["a"]})
    assert asdict(estimate) == {
        "accuracy": None,
        "interval": None,
        "scans": 0,
        "withheld": {code: 1},
    }
