# SPDX-License-Identifier: MIT
import io

import numpy as np
from rich.console import Console

from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import scores
from salsanext_cli.report.tables import ring_table, score_table

SPACE = LabelSpace.from_dict(
    {
        "labels": {0: "none", 1: "car [red]", 2: "road", 3: "tree"},
        "learning_map": {0: 0, 1: 1, 2: 2, 3: 3},
        "learning_map_inv": {0: 0, 1: 1, 2: 2, 3: 3},
    }
)


def printed(table) -> list[list[str]]:
    text = io.StringIO()
    Console(file=text, width=120).print(table)
    rows = [line.split("│")[1:-1] for line in text.getvalue().splitlines() if "│" in line]
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
        ["0–10 m", "75.0", "66.7", "3,000"],
        ["over 50 m", "–", "–", "0"],
    ]
