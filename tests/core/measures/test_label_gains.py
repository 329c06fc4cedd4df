# SPDX-License-Identifier: MIT
"""Gains of a few labelled scans: the trials are those of the page, their summary is computed."""

import re
from pathlib import Path

import pytest

from salsanext_cli.core.measures.label_gains import (
    FIVE,
    MANY_RIGHT,
    TRIALS,
    ZERO,
    GainRange,
    gains_of_trials,
)

PAGE = (Path(__file__).parents[3] / "docs/experiments/few-labels.md").read_text("utf-8")


@pytest.mark.parametrize(
    "trial", TRIALS, ids=lambda trial: f"{trial.drives} {trial.scans} {trial.version}"
)
def test_the_accuracies_of_each_trial_are_in_the_page(trial):
    if trial.before is None:
        assert f"+{trial.gain:.1f} / " in PAGE
    else:
        after = 100 * trial.before + trial.gain
        for accuracy in (100 * trial.before, after):
            assert re.search(rf"[ >]{accuracy:.1f} (±|/) ", PAGE)
    assert trial.data_set.partition(" ")[0] in PAGE
    assert f"version {trial.version}" in PAGE


def test_every_number_of_labelled_scans_of_the_page_has_its_trial():
    """The table has the accuracy before in its first row, and after it in the others."""
    table = PAGE.partition("## Number of scans, version 2")[2].partition("\nOther sensors")[0]
    rows = re.findall(r"^\| (\d+) \| ([\d.]+)", table, re.MULTILINE)
    (none, before), *after = [(int(scans), float(accuracy)) for scans, accuracy in rows]
    assert none == 0
    expected = {(scans, round(accuracy - before, 1)) for scans, accuracy in after}
    of_page = [trial for trial in TRIALS if trial.before == pytest.approx(before / 100)]
    assert {(trial.scans, trial.gain) for trial in of_page} == expected


def test_a_run_is_compared_with_the_newest_trials_that_began_as_well():
    for accuracy in (0.8, MANY_RIGHT):
        (gains,) = gains_of_trials(accuracy)
        assert gains.trials == FIVE
    (gains,) = gains_of_trials(0.6)
    # The newest weights have no such trial.
    low = [trial for trial in TRIALS if trial.before is not None and trial.before < MANY_RIGHT]
    assert gains.trials == tuple(low)


def test_without_an_estimate_both_kinds_of_trials_are_named():
    assert gains_of_trials(None) == [*gains_of_trials(0.8), *gains_of_trials(0.6)]


def test_the_text_has_worst_best_and_median():
    gains = GainRange(FIVE[1:])  # 2.0, 0.0 and 0.8 points with 27, 7 and 5 scans
    assert [gains.worst, gains.best, gains.median] == [0.0, 2.0, 0.8]
    assert gains.text == (
        "5 to 27 labelled scans gained 0.0 to 2.0 percentage points of accuracy (median 0.8) in "
        "3 trials of weights version 5 on SemanticKITTI that began with 80 to 86 % right labels "
        "where measured"
    )


def test_the_text_counts_the_trials_that_scored_the_labelled_drive():
    text = GainRange((FIVE[2], *ZERO)).text
    assert "5 trials of weights versions 0 and 5 on SemanticKITTI, PandaSet and simulated" in text
    assert text.endswith("; 3 of them scored the drive whose scans were labelled")
