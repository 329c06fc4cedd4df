# SPDX-License-Identifier: MIT
import io

import numpy as np
import pytest
from rich.console import Console, Group

from salsanext_cli.classes import label_space
from salsanext_cli.measures.calibration import Calibration, judge
from salsanext_cli.measures.figures import calibration_figures, uncertainty_figures
from salsanext_cli.measures.ranking import Ranking
from salsanext_cli.report.uncertainty_tables import trust_tables

SPACE = label_space()


def printed(tables) -> str:
    text = io.StringIO()
    Console(file=text, width=120).print(Group(*tables))
    return text.getvalue()


def rows_of(tables) -> list[list[str]]:
    rows = [line.split("│")[1:-1] for line in printed(tables).splitlines() if "│" in line]
    return [[cell.strip() for cell in row] for row in rows]


@pytest.fixture
def calibration():
    rows = np.tile(np.array([[0, 0.75, 0.25]], np.float16), (4, 1))
    judged = judge(rows, np.array([1, 1, 2, 2]))
    by_class = Calibration.none(SPACE.class_count).update(judged, judged.predicted)
    return calibration_figures(by_class, None, SPACE)


def ranked(*uncertainty):
    count = len(uncertainty)
    wrong = np.arange(count) == count - 1
    ranking = Ranking.none(SPACE.class_count)
    ranking.update(np.array(uncertainty, np.float32), wrong, np.ones(count, int))
    return uncertainty_figures(ranking, None, SPACE)


def test_a_row_of_calibration_and_one_for_each_kind(calibration):
    kinds = {"epistemic": ranked(0.1, 0.2, 0.4), "total": ranked(0.4, 0.4)}
    assert rows_of(trust_tables(calibration, kinds)) == [
        ["softmax", "0.837", "0.625", "25.00", "25.00", "25.00", "1", "4"],
        ["epistemic", "100.0", "100.0", "11.11", "0.000", "33.3", "1", "3"],
        ["total", "50.0", "50.0", "50.00", "0.500", "50.0", "1", "2"],
    ]


def test_what_has_no_answer_is_a_dash():
    nothing = calibration_figures(Calibration.none(SPACE.class_count), None, SPACE)
    assert rows_of(trust_tables(nothing, {"total": ranked()})) == [
        ["softmax", *"–––––", "0", "0"],
        ["total", *"–––––", "0", "0"],
    ]


def test_no_table_of_what_is_not_there(calibration):
    assert trust_tables(None, {}) == []
    assert "AUROC" not in printed(trust_tables(calibration, {}))
    assert "NLL" not in printed(trust_tables(None, {"total": ranked(0.1)}))


def test_tables_are_as_narrow_as_a_terminal(calibration):
    kinds = {"mutual_information": ranked(0.1, 0.2, 0.4)}
    assert max(map(len, printed(trust_tables(calibration, kinds)).splitlines())) <= 100
