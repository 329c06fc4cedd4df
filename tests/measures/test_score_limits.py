# SPDX-License-Identifier: MIT
"""Limits on scores, as `eval --fail-under` takes them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from evaluated import SPACE
from scans import refused

from salsanext_cli.errors import UsageError
from salsanext_cli.measures.score_limits import limits_of, scores_below
from salsanext_cli.measures.scores import scores

EMPTY = scores(np.zeros((SPACE.class_count, SPACE.class_count), int), SPACE)
HALF = replace(EMPTY, accuracy=0.5, iou_mean_present=0.25)


def test_limits_are_percentages_by_name():
    assert limits_of("mean_iou=40, accuracy = 80%") == {"mean_iou": 40, "accuracy": 80}
    assert limits_of("mean_iou=0.25%,accuracy=0") == {"mean_iou": 0.25, "accuracy": 0}
    assert limits_of(None) == {}


@pytest.mark.parametrize(
    "text",
    ["", "iou=3", "accuracy", "accuracy=much", "mean_iou=101", "accuracy=nan", "mean_iou=0.25"],
)
def test_other_limits_are_refused(text):
    with refused(UsageError, "--fail-under"):
        limits_of(text)


def test_a_score_is_low_below_its_limit_or_without_a_value():
    limits = {"mean_iou": 25.0, "accuracy": 50.1}
    (low,) = scores_below(limits, HALF)
    assert (low.name, low.score, low.limit) == ("accuracy", 50.0, 50.1)
    assert math.isnan(EMPTY.accuracy)
    assert [low.name for low in scores_below({"accuracy": 0.0}, EMPTY)] == ["accuracy"]
