# SPDX-License-Identifier: MIT
from collections import Counter
from dataclasses import replace

import numpy as np
from evaluation_runs import calibration_result, ranking_result, small_space
from printed_tables import text_of
from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.commands.line.output.tune_tables import error_table
from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.measures.survey import Survey
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.report.card_table import card_table
from salsanext_cli.report.picked import picked_table
from salsanext_cli.report.tables import (
    IMPORTED,
    accepted_table,
    band_table,
    imported_table,
    score_table,
    survey_tables,
    uncertainty_tables,
)
from salsanext_cli.runs.annotation.label_records import ImportedScan
from salsanext_cli.runs.annotation.picked_data_set import PickedScan
from salsanext_cli.training.tuning.error import ErrorScores, HeldOutScores

MANY = 430_123_456
SPACE = small_space("none", "car [red]", "road", "tree")


def printed(*tables) -> list[list[str]]:
    rows = [line.split("│")[1:-1] for line in text_of(*tables).splitlines() if "│" in line]
    return [[cell.strip() for cell in row] for row in rows]


def result():
    truth = np.repeat([1, 1, 2, 0], 1000)
    predicted = np.repeat([1, 0, 2, 2], 1000)
    return scores(confusion_matrix(truth, predicted, 4), SPACE)


def test_a_row_per_class_then_the_means():
    assert printed(score_table(result())) == [
        ["car [red]", "50.0", "100.0", "50.0", "2,000"],
        ["road", "100.0", "100.0", "100.0", "1,000"],
        ["tree", "–", "–", "–", "0"],
        ["accuracy, all labelled points", "66.7", "", "", "3,000"],
        ["accuracy, predicted (official)", "100.0", "", "", ""],
        ["mean IoU, all 3 (official)", "50.0", "", "", ""],
        ["mean IoU, 2 classes present", "75.0", "", "", ""],
    ]


def test_bands_are_compared_in_the_same_classes():
    """A mean over classes of other bands would not be comparable."""
    nothing = scores(np.zeros((4, 4), np.int64), SPACE)
    assert printed(band_table({"0–10 m": result(), "over 50 m": nothing})) == [
        ["0–10 m", "75.0", "66.7", "3,000", ""],
        ["over 50 m", "–", "–", "0", "car [red], road"],
    ]
    far = scores(confusion_matrix(np.array([2, 2]), np.array([2, 1]), 4), SPACE)
    rows = printed(band_table({"0–10 m": result(), "10–20 m": far, "20–30 m": result()}))
    assert [row[1::3] for row in rows] == [["100.0", ""], ["50.0", "car [red]"], ["100.0", ""]]


def ranked(*uncertainty):
    """Return the ranking of points of which the last is wrong."""
    count = len(uncertainty)
    return ranking_result(uncertainty, np.arange(count) == count - 1)


def tables_of(calibration=None, **kinds):
    return uncertainty_tables(UncertaintyEvaluation(calibration=calibration, kinds=kinds))


def test_a_row_of_calibration_and_one_for_each_kind_with_dashes_where_undefined():
    kinds = {"epistemic": ranked(0.1, 0.2, 0.4), "total": ranked(0.4, 0.4)}
    assert printed(*tables_of(calibration_result([1, 1, 2, 2]), **kinds)) == [
        ["softmax", "0.837", "0.625", "25.00", "25.00", "1", "4"],
        ["epistemic", "100.0", "100.0", "11.11", "33.3", "3"],
        ["total", "50.0", "50.0", "50.00", "50.0", "2"],
    ]
    tables = tables_of(calibration_result([]), mutual_information=ranked())
    rows = [["softmax", *"––––", "0", "0"], ["mutual_information", *"––––", "0"]]
    assert printed(*tables) == rows
    assert tables_of() == []
    assert [len(tables_of(calibration_result([1]))), len(tables_of(total=ranked(0.1)))] == [1, 1]


def tables_of_a_large_data_set(weights):
    """Yield every table, with names and numbers as long as those of a large data set."""
    space = label_space()
    every = np.eye(20, dtype=np.int64) * MANY // 20
    few = confusion_matrix(np.array([1, 2]), np.array([2, 2]), 20)
    yield score_table(scores(every, space), "scores on scans that the weights were trained on")
    yield score_table(scores(few, space))
    yield band_table({"0–10 m": scores(every, space), "over 50 m": scores(few, space)})
    calibration, ranking = calibration_result([1, 2]), ranked(0.1, 0.2)
    calibration = replace(calibration, scans=4071, points=MANY)
    ranking = replace(ranking, points=MANY, wrong=MANY // 3)
    yield from tables_of(calibration, mutual_information=ranking, error=replace(ranking, ece=0.1))
    error = ErrorScores(ece=0.1, risk_80=0.1, auroc=0.9, aurc=0.1, nll=0.5)
    yield error_table(HeldOutScores(folds=5, error=error, existing=error, confidence=error))
    yield accepted_table({"person-or-cycle": (MANY, 1000)})
    described = describe_weights(weights)
    card = replace(described.card, scores={"iou_other-vehicle": 0.5})
    yield card_table(replace(described, card=card))
    survey = Survey(
        scans=4071,
        labelled=4071,
        points=MANY,
        invalid=MANY,
        smallest=117_000,
        largest=131_072,
        farthest=119.9,
        brightest=255,
        classes=Counter({10: MANY}),
    )
    yield survey_tables({"2011_09_26_drive_0001": survey}, survey, space, SMALL)
    counts = dict.fromkeys((*IMPORTED, "unmatched"), 131_072)
    imported = ImportedScan(scan="08/000000", files=(), **counts, scalar="scalar_Classification")
    yield imported_table([imported])
    reason = "number 3 of 4,071 by uncertainty; nearly equal ones passed over"
    yield picked_table(
        [
            PickedScan(
                rank=1,
                sequence="2011_09_26",
                scan="0000000000",
                uncertainty=0.5,
                distance=1.5,
                nearest=None,
                reason=reason,
            )
        ]
    )


def test_no_table_is_cut_in_a_terminal_of_80_columns(weights):
    text = text_of(*tables_of_a_large_data_set(weights), width=80)
    assert "…" not in text.replace(" … ", "")
    words = {"mutual_information", "salsanext", "person-or-cycle", f"{MANY:,}", "4,071"}
    words |= {"unlabelled", "117,000", "other-vehicle"}
    assert {word for word in words if word not in text} == set()
