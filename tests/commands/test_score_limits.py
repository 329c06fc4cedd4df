# SPDX-License-Identifier: MIT
"""Limits on scores, as `eval --fail-under` and `eval --fail-over` take them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from evaluated import SPACE, calibration_result, ranking_result
from scans import refused

from salsanext_cli.commands.score_limits import (
    FAIL_OVER,
    FAIL_UNDER,
    SCORE_KINDS,
    missed_limits,
    parse_limits,
    require_classes,
    score_values,
)
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts, AcceptedLabels
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation

CAR, PERSON, ROAD = (SPACE.names.index(name) for name in ("car", "person", "road"))
TRUTH = np.array([CAR, CAR, PERSON, PERSON, PERSON, PERSON, ROAD, ROAD])
PREDICTED = np.array([CAR, 0, PERSON, ROAD, PERSON, PERSON, ROAD, CAR])
CONFUSION = confusion_matrix(TRUTH, PREDICTED, SPACE.class_count)
SCORES = scores(CONFUSION, SPACE)
NOTHING = UncertaintyEvaluation(calibration=None, kinds={})
CHECK = RiskBoundCheck(
    at_most=0.1, confidence=None, unit="scan", units=10, above=3, mean=0.08, worst=0.4
)


def limits_in(text, option):
    return {limit.name: limit.limit for limit in parse_limits(text, option)}


def missed(text, option, values, guarantee=None, doubt=""):
    limits = parse_limits(text, option)
    return [limit.name for limit in missed_limits(limits, values, guarantee, doubt)]


def test_limits_are_numbers_in_the_unit_of_their_score_by_name():
    assert limits_in("mean_iou=40, accuracy = 80%", FAIL_UNDER) == {"mean_iou": 40, "accuracy": 80}
    assert limits_in("iou.other-vehicle=0.25%", FAIL_UNDER) == {"iou.other-vehicle": 0.25}
    assert limits_in("nll=0.5,brier=0.1,ece=2", FAIL_OVER) == {"nll": 0.5, "brier": 0.1, "ece": 2}
    assert parse_limits(None, FAIL_UNDER) == ()


@pytest.mark.parametrize(
    ("option", "text"),
    [
        (FAIL_UNDER, ""),
        (FAIL_UNDER, "iou=3"),
        (FAIL_UNDER, "accuracy.car=3"),
        (FAIL_UNDER, "accuracy"),
        (FAIL_UNDER, "accuracy=much"),
        (FAIL_UNDER, "mean_iou=101"),
        (FAIL_UNDER, "accuracy=nan"),
        (FAIL_UNDER, "mean_iou=0.25"),
        (FAIL_UNDER, "auroc.luck=50"),
        (FAIL_OVER, "nll=50%"),
        (FAIL_OVER, "nll=inf"),
        (FAIL_OVER, "guarantee=10"),
        (FAIL_OVER, "ece=-1"),
    ],
)
def test_other_limits_are_refused(option, text):
    with refused(UsageError, option):
        parse_limits(text, option)


@pytest.mark.parametrize(
    ("option", "text", "hint"),
    [
        (FAIL_UNDER, "miou=40", "did you mean mean_iou?"),
        (FAIL_OVER, "ece=0.02", "use ece=2, or ece=0.02% if this is meant"),
        (FAIL_UNDER, "ece=2", "use --fail-over ece=2"),
        (FAIL_OVER, "iou.person=2", "use --fail-under iou.person=2"),
        (FAIL_UNDER, "guarantee", "use --fail-over guarantee"),
        (FAIL_OVER, "aurc.errors=5", "did you mean error?"),
    ],
)
def test_the_hint_about_a_wrong_limit_can_be_typed(option, text, hint):
    with pytest.raises(UsageError) as caught:
        parse_limits(text, option)
    assert caught.value.hint == hint


def test_a_class_is_one_that_the_label_space_scores():
    require_classes(parse_limits("iou.person=1,accuracy=1", FAIL_UNDER), SPACE)
    for name, hint in {"persn": "did you mean person?", "unlabeled": ""}.items():
        with pytest.raises(UsageError) as caught:
            require_classes(parse_limits(f"recall.{name}=1", FAIL_UNDER), SPACE)
        assert (caught.value.subject, caught.value.hint) == ("--fail-under recall", hint)


def test_scores_are_percentages_by_name():
    """IoU by hand: car 1 of 3, person 3 of 4, road 1 of 3."""
    values = score_values(SCORES, NOTHING, None)
    assert values["accuracy"] == pytest.approx(62.5)
    assert values["iou.person"] == pytest.approx(75)
    assert values["iou.car"] == pytest.approx(100 / 3)
    assert values["precision.road"] == pytest.approx(50)
    assert values["recall.person"] == pytest.approx(75)
    assert values["mean_iou"] == pytest.approx((75 + 200 / 3) / 3)
    assert math.isnan(values["iou.truck"])
    assert not {"ece", "ece_of_error", "risk"} & values.keys()


def test_every_kind_of_score_has_a_value_if_its_results_are_there():
    error = replace(ranking_result([0.1, 0.9], [False, True]), ece=0.03)
    uncertainty = UncertaintyEvaluation(
        calibration=calibration_result([1, 1, 2]), kinds={"error": error}
    )
    counts = {"a/0": AcceptedCounts(points=8, accepted=7, wrong=2)}
    accepted = AcceptedLabels.from_confusion(CONFUSION, SPACE, counts)
    values = score_values(SCORES, uncertainty, accepted)
    assert {name.partition(".")[0] for name in values} == SCORE_KINDS.keys() - {"guarantee"}
    assert values["ece_of_error"] == pytest.approx(3)
    assert values["ece"] == pytest.approx(100 * uncertainty.calibration.ece)
    assert values["nll"] == uncertainty.calibration.nll
    assert values["aurc.error"] == pytest.approx(100 * error.aurc)
    assert values["coverage"] == pytest.approx(100 * 7 / 8)
    assert values["risk"] == pytest.approx(100 * 2 / 7)
    assert values["missed_people"] == pytest.approx(25)


def test_a_limit_is_missed_on_its_side_or_without_a_value():
    values = {"mean_iou": 25.0, "accuracy": 50.0, "ece": 2.0, "nll": math.nan}
    assert missed("mean_iou=25,accuracy=50.1", FAIL_UNDER, values) == ["accuracy"]
    assert missed("iou.person=0", FAIL_UNDER, values) == ["iou.person"]
    assert missed("ece=2", FAIL_OVER, values) == []
    assert missed("ece=1.9,nll=99", FAIL_OVER, values) == ["ece", "nll"]


@pytest.mark.parametrize(
    ("check", "doubt", "is_missed"),
    [
        (CHECK, "", False),
        (replace(CHECK, mean=0.11), "", True),
        (replace(CHECK, confidence=0.7), "", False),  # Three of ten scans may be above
        (replace(CHECK, confidence=0.8), "", True),
        (CHECK, "the threshold was chosen on these scans", True),
        (None, "", True),
    ],
)
def test_the_guarantee_is_a_limit_of_its_own(check, doubt, is_missed):
    assert missed("guarantee", FAIL_OVER, {}, check, doubt) == ["guarantee"] * is_missed
