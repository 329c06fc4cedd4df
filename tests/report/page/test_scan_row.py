# SPDX-License-Identifier: MIT
"""Rows of the table of scans."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from evaluation_runs import run_of, small_space
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy
from salsanext_cli.report.page.drive_data import drive_data
from salsanext_cli.report.page.run_results import RunResults
from salsanext_cli.report.page.scan_row import PointErrors, ScanRow
from salsanext_cli.runs.scans.scan_file import ScanFile

SPACE = small_space("unlabeled", "car", "road")


def row(stem, confusion=None, sequence="00", **uncertainty):
    file = ScanFile(sequence=sequence, stem=stem, path=Path(f"/{stem}.bin"))
    matrix = np.zeros((3, 3), int) if confusion is None else np.array(confusion)
    return ScanRow(
        file=file,
        points=10,
        class_points=np.array([0, 5, 5]),
        uncertainty=uncertainty,
        confusion=matrix,
    )


def test_wrong_points_are_judged_ones_and_the_error_leads_before_the_entropy():
    assert row("a", [[0, 0, 0], [1, 3, 0], [0, 2, 4]]).wrong == pytest.approx(3 / 10)
    assert math.isnan(row("a").wrong)
    assert math.isnan(row("a", np.zeros((3, 3), int)).wrong)
    rows = [row("1", entropy=1.0), row("2", error=0.5)]
    assert run_of(rows=rows).leading_kind == "error"
    assert run_of(rows=rows[:1]).leading_kind == "entropy"
    assert run_of(rows=[row("3")]).leading_kind is None


def test_most_uncertain_most_wrong_and_worst_class_are_chosen():
    rows = [
        row("0", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.1),
        row("1", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.9),
        row("2", [[0, 0, 0], [0, 0, 0], [0, 0, 10]], entropy=math.nan),
        row("3", [[0, 0, 0], [0, 1, 4], [0, 0, 95]], entropy=0.2),
        row("4", [[0, 0, 0], [0, 5, 0], [0, 3, 2]], entropy=0.2),
    ]
    run = run_of(rows=rows, space=SPACE)
    chosen = run.notable_scans()
    assert chosen["00/1"] == "most uncertain (mean entropy 0.9)"
    assert chosen["00/4"] == "most wrong (30.0 % of the labelled points)"
    assert chosen["00/3"] == "worst class: 4 points of car wrong"
    assert sorted(chosen.values())[0] == "at random"
    assert len(chosen) == 4
    assert chosen == run.notable_scans()
    rejecting = replace(run, reader=replace(run.reader, rejects=True))
    wrong = rejecting.notable_scans()["00/4"]
    assert wrong == "most wrong (30.0 % of the accepted points with a true class)"


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("error", "mean probability of error 18.6 %"),
        ("least_confidence", "mean 1 − confidence 18.6 %"),
        ("disagreement", "mean disagreement 18.6 %"),
        ("entropy", "mean entropy 0.186"),
        ("mutual_information", "mean mutual information 0.186"),
    ],
)
def test_a_mean_uncertainty_has_one_title_and_shares_are_percentages(kind, words):
    run = run_of(rows=[row("1", **{kind: 0.1862})], space=SPACE)
    assert run.leading_kind == kind
    assert run.notable_scans()["00/1"] == f"most uncertain ({words})"
    numbers = drive_data(run, np.ones((1, 3), int), ["00/1"], {})
    assert numbers["is_share"] == words.endswith("%")


def test_scans_are_named_by_sequence_and_stem_or_by_the_stem_alone():
    rows = [row("1", sequence="00"), row("1", sequence="08"), row("2", sequence="08")]
    run = run_of(rows=rows)
    assert run.scans_by_name(["2", "00/1"]) == {"08/2": "named", "00/1": "named"}
    for name in ("1", "08/9"):
        with pytest.raises(UsageError) as caught:
            run.scans_by_name([name])
        assert (caught.value.subject, caught.value.code) == ("scans", "usage")


@pytest.mark.parametrize(
    ("training_scans", "estimate", "measured"),
    [(0, None, 0.7), (0, 0.5, 0.7), (1, 0.5, None), (1, 0.8, 0.7), (1, None, None)],
)
def test_scores_of_training_scans_count_only_against_the_labels(
    monkeypatch, training_scans, estimate, measured
):
    expected = (
        None
        if estimate is None
        else ExpectedAccuracy(accuracy=estimate, interval=(0.0, 1.0), scans=1, withheld={})
    )
    monkeypatch.setattr(RunResults, "expected_accuracy", lambda _: expected)
    confusion = np.array([[0, 0, 0], [0, 3, 2], [0, 1, 4]])
    counts = ScanCounts(confusion=confusion, scans=1, training_scans=training_scans)
    run = replace(run_of(rows=[row("1")], space=SPACE), counts=counts)
    assert run.evidence().measured == measured
    rejecting = replace(counts, accepted={"00/1": (12, 10, 3)})
    assert replace(run, counts=rejecting).evidence().measured is None


@given(st.lists(st.floats(0, 1, width=32) | st.just(math.nan), max_size=20))
def test_errors_are_counted_over_the_points_that_have_one(values):
    errors = PointErrors.from_values(np.array(values, np.float32))
    known = [value for value in values if not math.isnan(value)]
    assert errors.points == len(known)
    assert errors.total == pytest.approx(sum(known), abs=1e-5)
    assert errors.doubtful == sum(value > np.float32(0.1) for value in known)
    assert (errors + errors).points == 2 * len(known)
    if known:
        assert (errors + errors).doubtful_share == errors.doubtful_share
        assert errors.mean == pytest.approx(sum(known) / len(known), abs=1e-5)
    else:
        assert (errors.mean, errors.doubtful_share) == (None, None)
