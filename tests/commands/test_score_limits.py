# SPDX-License-Identifier: MIT
"""Limits on scores, and the scores that do not keep to them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from evaluation_runs import SPACE, calibration_result, ranking_result
from scans import refused

from salsanext_cli.commands.line.options.option_names import CommandLine
from salsanext_cli.commands.score_limits import (
    SCORE_KINDS,
    ScoreLimit,
    judged_limits,
    require_classes,
    score_values,
)
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts, AcceptedLabels
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import confusion_matrix, scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.wording import Spelling, spelled

CAR, PERSON, ROAD = (SPACE.names.index(name) for name in ("car", "person", "road"))
TRUTH = np.array([CAR, CAR, PERSON, PERSON, PERSON, PERSON, ROAD, ROAD])
PREDICTED = np.array([CAR, 0, PERSON, ROAD, PERSON, PERSON, ROAD, CAR])
CONFUSION = confusion_matrix(TRUTH, PREDICTED, SPACE.class_count)
SCORES = scores(CONFUSION, SPACE)
NOTHING = UncertaintyEvaluation(calibration=None, kinds={})
CHECK = RiskBoundCheck(
    at_most=0.1, confidence=None, unit="scan", units=10, above=3, mean=0.08, worst=0.4
)


def limits(**limit_of_name):
    return [ScoreLimit(name=name, limit=limit) for name, limit in limit_of_name.items()]


def missed(chosen, values, guarantee=None, doubt=""):
    judged = judged_limits(chosen, values, guarantee, doubt)
    assert [limit.name for limit in judged] == [limit.name for limit in chosen]
    return [limit.name for limit in judged if not limit.is_kept]


def test_a_class_is_one_that_the_label_space_scores():
    require_classes(limits(**{"iou.person": 1, "accuracy": 1}), SPACE)
    for name, hint in {"persn": "did you mean person?", "unlabeled": ""}.items():
        recall = limits(**{f"recall.{name}": 1})
        caught = refused(UsageError, f"limit of recall.{name}", require_classes, recall, SPACE)
        assert caught.value.hint == hint


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
    assert missed(limits(mean_iou=25, accuracy=50.1), values) == ["accuracy"]
    assert missed(limits(**{"iou.person": 0}), values) == ["iou.person"]
    assert missed(limits(ece=2), values) == []
    assert missed(limits(ece=1.9, nll=99), values) == ["ece", "nll"]


@pytest.mark.parametrize("spelling", [Spelling(), CommandLine()])
def test_a_score_without_results_has_a_hint_in_the_words_of_the_caller(spelling):
    """The hint of every kind names an argument or an option; scores of labels need none."""
    needing = {name: kind for name, kind in SCORE_KINDS.items() if kind.needs}
    assert len(needing) == 12
    with spelled(spelling):
        scores_without_value = judged_limits(limits(**dict.fromkeys(needing, 1)), {}, None)
    assert [score.name for score in scores_without_value] == [*needing]
    for score in scores_without_value:
        hint = score.reason.partition("\nhint: ")[2]
        assert hint.startswith("run `salsanext ")
        assert ("--" in hint) == isinstance(spelling, CommandLine)


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
    limit = limits(guarantee=math.nan)
    assert missed(limit, {}, check, doubt) == ["guarantee"] * is_missed
