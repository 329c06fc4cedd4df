# SPDX-License-Identifier: MIT
"""Values of `eval --fail-under` and `eval --fail-over`."""

import pytest
from scans import refused

from salsanext_cli.commands.line.values.limit_options import FAIL_OVER, FAIL_UNDER, parse_limits
from salsanext_cli.core.errors import UsageError


def limits_in(text, option):
    return {limit.name: limit.limit for limit in parse_limits(text, option)}


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
