# SPDX-License-Identifier: MIT
import math
from pathlib import Path

import numpy as np
import pytest
from evaluated import small_space

from salsanext_cli.errors import UsageError
from salsanext_cli.report.page.run_results import ScanRow, leading_kind, named, worth_looking_at
from salsanext_cli.results.layout import ScanFile

SPACE = small_space("unlabeled", "car", "road")


def row(stem, confusion=None, sequence="00", **uncertainty):
    file = ScanFile(sequence, stem, Path(f"/{stem}.bin"))
    matrix = None if confusion is None else np.array(confusion)
    return ScanRow(file, 10, np.array([0, 5, 5]), uncertainty, matrix)


def test_the_share_of_wrong_points_leaves_out_what_is_not_judged():
    assert row("a", [[0, 0, 0], [1, 3, 0], [0, 2, 4]]).wrong == pytest.approx(3 / 10)
    assert math.isnan(row("a").wrong)
    assert math.isnan(row("a", np.zeros((3, 3), int)).wrong)


def test_most_uncertain_most_wrong_and_worst_class_are_chosen():
    rows = [
        row("0", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.1),
        row("1", [[0, 0, 0], [0, 9, 1], [0, 0, 90]], entropy=0.9),
        row("2", [[0, 0, 0], [0, 0, 0], [0, 0, 10]], entropy=math.nan),
        row("3", [[0, 0, 0], [0, 1, 4], [0, 0, 95]], entropy=0.2),
        row("4", [[0, 0, 0], [0, 5, 0], [0, 3, 2]], entropy=0.2),
    ]
    found = worth_looking_at(rows, SPACE)
    assert found["00/1"] == "most uncertain (mean entropy 0.9)"
    assert found["00/4"] == "most wrong (30.0 % of the points)"
    assert found["00/3"] == "worst class: 4 points of car wrong"
    assert sorted(found.values())[0] == "at random"
    assert len(found) == 4
    assert found == worth_looking_at(rows, SPACE)


def test_the_error_leads_before_the_entropy():
    rows = [row("1", entropy=1.0), row("2", error=0.5)]
    assert leading_kind(rows) == "error"
    assert leading_kind(rows[:1]) == "entropy"
    assert leading_kind([row("3")]) is None


def test_scans_are_named_by_sequence_and_stem_or_by_the_stem_alone():
    rows = [row("1", sequence="00"), row("1", sequence="08"), row("2", sequence="08")]
    assert named(rows, ["2", "00/1"]) == {"08/2": "named", "00/1": "named"}
    for name, says in (("1", "2 scans"), ("08/9", "no results of a scan of that name")):
        with pytest.raises(UsageError, match=says):
            named(rows, [name])
