# SPDX-License-Identifier: MIT
"""The printed table of a weights card."""

from dataclasses import replace

import numpy as np
from printed_tables import text_of

from salsanext_cli.commands.stages.models import describe_weights
from salsanext_cli.core.network.card import INHERITED
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.report.card_table import card_table


def test_a_card_has_words_for_its_keys(weights):
    scores = {"auroc": 0.875, "aurc": 0.05, "ece": 0.01, "nll": 0.34, "risk_80": 0.1}
    fitted = {
        "fitted_to": "3 scans of 08",
        "sequences": ["00", "08"],
        "scans": 3,
        "points": 4_758_412,
        "wrong": 0.207,
        "several": 0.015,
        "folds": 5,
        "error": scores,
        "existing": None,
        "confidence": scores | {"auroc": 0.845},
        INHERITED: "other weights",
    }
    described = describe_weights(weights)
    error = ErrorModel(
        features=("a",), layers=[(np.ones((1, 1), "f4"), np.zeros(1, "f4"))], scores=fitted
    )
    named = {"miou": 0.5, "miou_spread": 0.1, "iou_other-vehicle": 0.25}
    card = replace(described.card, scores=named, error=error)
    rows = dict(printed_wide(card_table(replace(described, card=card))))
    network = {"name": "salsanext", "class_count": 20, "dropout": 0.1}
    networks = replace(described, card=replace(card, architecture=network))
    assert dict(printed_wide(card_table(networks)))["architecture"] == (
        "salsanext, 20 classes, dropout 0.100"
    )
    assert rows["error model on 5 folds of held-out scans"].startswith("AUROC 0.875, AURC 0.050")
    assert rows["confidence, to compare"].startswith("AUROC 0.845")
    assert rows["points of the error model"].startswith(
        "4,758,412 points, 20.7 % wrong, 1.5 % skipped"
    )
    assert rows["error model, fitted to"] == "3 scans of 08 (3 scans of 00, 08)"
    assert rows["inherited from"] == "other weights"
    assert "the error model before" not in rows
    text = " ".join(" ".join(row) for row in rows.items())
    assert not {"_", "None", "{", "["} & {*text.replace(str(weights), "")}
    for key in ("auroc", "aurc", "ece", "nll", "risk_80", "fitted_to", "class_count", "miou"):
        assert key not in text


def printed_wide(table):
    """Return the rows of a table in a terminal so wide that no cell is broken."""
    rows = [line.split("│")[1:-1] for line in text_of(table, width=400).splitlines() if "│" in line]
    return [tuple(cell.strip() for cell in row) for row in rows]
