# SPDX-License-Identifier: MIT
import io

import numpy as np
from evaluated import calibration_result, ranking_result, small_space
from rich.console import Console, Group

from salsanext_cli.measures.scores import Confusion, scores
from salsanext_cli.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.report.tables import (
    kept_table,
    ring_table,
    score_table,
    uncertainty_tables,
)

SPACE = small_space("none", "car [red]", "road", "tree")


def text_of(*tables, width=120) -> str:
    text = io.StringIO()
    Console(file=text, width=width).print(Group(*tables))
    return text.getvalue()


def printed(*tables) -> list[list[str]]:
    rows = [line.split("│")[1:-1] for line in text_of(*tables).splitlines() if "│" in line]
    return [[cell.strip() for cell in row] for row in rows]


def result():
    truth = np.repeat([1, 1, 2, 0], 1000)
    predicted = np.repeat([1, 0, 2, 2], 1000)
    return scores(Confusion(4).update(truth, predicted), SPACE)


def test_a_row_per_class_then_the_means():
    assert printed(score_table(result())) == [
        ["car [red]", "50.0", "100.0", "50.0", "2,000"],
        ["road", "100.0", "100.0", "100.0", "1,000"],
        ["tree", "–", "–", "–", "0"],
        ["accuracy", "66.7", "", "", "3,000"],
        ["accuracy, official", "100.0", "", "", ""],
        ["mean IoU, official", "50.0", "", "", ""],
        ["mean IoU, 2 classes present", "75.0", "", "", ""],
    ]


def test_a_row_per_ring():
    nothing = scores(Confusion(4), SPACE)
    assert printed(ring_table({"0–10 m": result(), "over 50 m": nothing})) == [
        ["0–10 m", "75.0", "66.7", "3,000", ""],
        ["over 50 m", "–", "–", "0", "car [red], road"],
    ]


def test_rings_are_compared_in_the_same_classes():
    """Of classes of other rings only, the mean of a ring says nothing."""
    far = scores(Confusion(4).update(np.array([2, 2]), np.array([2, 1])), SPACE)
    rows = printed(ring_table({"0–10 m": result(), "10–20 m": far, "20–30 m": result()}))
    assert [(row[1], row[4]) for row in rows] == [
        ("100.0", ""),
        ("50.0", "car [red]"),
        ("100.0", ""),
    ]


def test_a_class_with_a_threshold_of_its_own_has_a_row_though_none_is_kept():
    assert printed(kept_table({"car": (10, 1), "road": (5, 0)}, {"bus": -1.0, "car": 0.125})) == [
        ["car", "10", "10.0", "0.125"],
        ["road", "5", "0.0", ""],
        ["bus", "0", "–", "none kept"],
    ]


def ranked(*uncertainty):
    """Return what is found of points of which the last is wrong."""
    count = len(uncertainty)
    return ranking_result(uncertainty, np.arange(count) == count - 1)


def tables_of(calibration=None, **kinds):
    return uncertainty_tables(UncertaintyEvaluation(calibration, kinds))


def test_a_row_of_calibration_and_one_for_each_kind():
    kinds = {"epistemic": ranked(0.1, 0.2, 0.4), "total": ranked(0.4, 0.4)}
    assert printed(*tables_of(calibration_result([1, 1, 2, 2]), **kinds)) == [
        ["softmax", "0.837", "0.625", "25.00", "25.00", "25.00", "1", "4"],
        ["epistemic", "100.0", "100.0", "11.11", "0.000", "33.3", "3"],
        ["total", "50.0", "50.0", "50.00", "0.500", "50.0", "2"],
    ]


def test_undefined_scores_are_dashes_and_absent_results_have_no_table():
    tables = tables_of(calibration_result([]), mutual_information=ranked())
    assert printed(*tables) == [
        ["softmax", *"–––––", "0", "0"],
        ["mutual_information", *"–––––", "0"],
    ]
    assert tables_of() == []
    assert [len(tables_of(calibration_result([1]))), len(tables_of(total=ranked(0.1)))] == [1, 1]
