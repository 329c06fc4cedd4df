# SPDX-License-Identifier: MIT
"""Evaluation of the kind of uncertainty that is a probability of error."""

import json

import numpy as np
import pytest
from evaluated import CAR, ROAD, World
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.measures.calibration import reliability
from salsanext_cli.measures.histograms import error_histogram

pytestmark = pytest.mark.usefixtures("undrawn")


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def slow_ece(error, wrong) -> float:
    """Return the mean gap between the share of wrong points and the mean error in 15 bins."""
    gaps = np.zeros(15)
    for probability, is_wrong in zip(error, wrong, strict=True):
        place = max(int(np.ceil(float(probability) * 15)) - 1, 0)
        gaps[place] += is_wrong - float(probability)
    return np.abs(gaps).sum() / len(wrong)


@given(st.lists(st.tuples(st.floats(0, 1, width=16), st.booleans()), min_size=1, max_size=50))
def test_calibration_error_is_that_of_a_slow_loop(points):
    error, wrong = (np.array(column) for column in zip(*points, strict=True))
    found = reliability(error_histogram(error.astype(np.float32), wrong).counts[:, 0])
    assert found.error == pytest.approx(slow_ece(error, wrong), abs=1e-12)


def test_it_is_scored_as_the_others_are_and_as_a_probability(world):
    """Of points with an error of a half, half are wrong; of those with 1/8, none is."""
    world.add("000000", [CAR, CAR, CAR, 0], [CAR, ROAD, CAR, CAR])
    world.put("uncertainty/error", "000000", [0.5, 0.5, 0.125, 0.9])
    world.add("000001", [ROAD, ROAD], [ROAD, ROAD])
    world.put("uncertainty/error", "000001", [0.125, np.nan])
    evaluation = world.evaluate(by_distance=True)
    found = evaluation.uncertainty.kinds["error"]
    assert (found.scores.points, found.scores.wrong, found.left_out) == (4, 1, 1)
    assert found.scores.auroc == pytest.approx(5 / 6)
    assert found.ece == pytest.approx(2 * 0.125 / 4)
    report = json.loads((world.out / "eval.json").read_text())
    assert report["uncertainty"]["error"]["ece"] == found.ece
    assert report["kept"]["kind"] == "error"
    assert (report["kept"]["coverage"], report["kept"]["risk"]) == (0.5, 0)
    assert report["kept"]["sentence"] == evaluation.uncertainty.kept.sentence
    assert 0.125 < report["kept"]["threshold"] < 0.5
    assert (world.out / "eval_risk_coverage.png").exists()


@pytest.mark.parametrize(
    ("truth", "error", "entropy", "kind"),
    [
        ([CAR, ROAD], [0.1, 0.5], [0.5, 0.1], "error"),
        ([CAR, ROAD], None, [0.5, 0.1], "entropy"),
        ([CAR, ROAD], [np.nan, np.nan], [0.5, 0.1], "entropy"),
        ([CAR, ROAD], [np.nan, np.nan], None, None),
        ([CAR, ROAD], None, None, None),
        ([0, 0], [0.1, 0.5], [0.5, 0.1], None),
    ],
)
def test_threshold_is_of_the_error_else_of_the_entropy(world, truth, error, entropy, kind):
    world.add("000000", truth, [CAR, CAR])
    world.put("uncertainty/total", "000000", [0.1, 0.2])
    for name, values in (("error", error), ("entropy", entropy)):
        if values is not None:
            world.put(f"uncertainty/{name}", "000000", values)
    kept = world.evaluate().uncertainty.kept
    assert (kept and kept.kind) == kind
    assert ("kept" in json.loads((world.out / "eval.json").read_text())) == (kind is not None)
