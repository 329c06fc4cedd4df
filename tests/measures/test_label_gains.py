# SPDX-License-Identifier: MIT
"""Gains of a few labelled scans: the trials are those of the page, their summary is computed."""

from pathlib import Path

import pytest

from salsanext_cli.measures.label_gains import MANY_RIGHT, TRIALS, GainRange, gains_of_trials

PAGE = Path(__file__).parents[2] / "docs/experiments/few-labels.md"


@pytest.mark.parametrize("trial", TRIALS, ids=lambda trial: f"{trial.drives} {trial.version}")
def test_the_accuracies_of_each_trial_are_in_the_page(trial):
    page = PAGE.read_text("utf-8")
    for accuracy in (trial.before, trial.after):
        assert f" {100 * accuracy:.1f} / " in page
    assert trial.data_set in page
    assert f"version {trial.version}" in page


@pytest.mark.parametrize(("accuracy", "is_high"), [(0.8, True), (MANY_RIGHT, True), (0.6, False)])
def test_a_run_is_compared_with_trials_that_began_as_well(accuracy, is_high):
    (gains,) = gains_of_trials(accuracy)
    assert gains.trials == tuple(t for t in TRIALS if (t.before >= MANY_RIGHT) == is_high)


def test_without_an_estimate_all_trials_are_named_once():
    trials = [trial for gains in gains_of_trials(None) for trial in gains.trials]
    assert sorted(trials, key=TRIALS.index) == list(TRIALS)


def test_the_text_has_worst_best_and_median():
    gains = GainRange(TRIALS[:3])  # 0.0, 0.8 and 2.8 points with 7, 5 and 12 scans
    assert [round(value, 1) for value in (gains.worst, gains.best, gains.usual)] == [0.0, 2.8, 0.8]
    assert gains.text == (
        "5 to 12 labelled scans gained 0.0 to 2.8 points of accuracy (median 0.8) in 3 trials on "
        "SemanticKITTI that began with 80 to 86 % right labels"
    )
