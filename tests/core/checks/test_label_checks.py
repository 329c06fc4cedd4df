# SPDX-License-Identifier: MIT
"""Labels are doubted beyond a share of one class, and below a mean confidence."""

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.core.checks.label_checks import (
    MAX_SHARE,
    MAX_SHARE_OF_FEW,
    MIN_CONFIDENCE,
    MIN_CONFIDENCE_OF_FEW,
    label_findings,
)
from salsanext_cli.core.checks.warning_codes import WarningCode

TOTAL = 100_000
SPACES = {
    "semantic-kitti": (MAX_SHARE, MIN_CONFIDENCE),
    "coarse": (MAX_SHARE_OF_FEW, MIN_CONFIDENCE_OF_FEW),
}
"""Limits of the share and of the confidence, by label space."""


def codes(name: str, share: float, confidence: float) -> list[str]:
    """Return the codes for labels of which a share is of class 2 and the rest of class 1."""
    space = label_space(name)
    points = np.zeros(space.class_count, np.int64)
    points[2] = round(share * TOTAL)
    points[1] = TOTAL - points[2]
    points[0] = 10 * TOTAL  # Unlabelled points are not counted.
    return [finding.code for finding in label_findings(points, confidence, space)]


@pytest.mark.parametrize("name", SPACES)
def test_one_class_is_doubted_above_its_share(name):
    most, least = SPACES[name]
    assert codes(name, most, least) == []
    assert codes(name, most + 1.5 / TOTAL, least) == [WarningCode.ONE_CLASS]


@pytest.mark.parametrize("name", SPACES)
def test_low_confidence_is_doubted_below_its_limit(name):
    _, least = SPACES[name]
    assert codes(name, 0.5, least - 0.001) == [WarningCode.LOW_CONFIDENCE]


def test_few_points_say_nothing_of_the_share():
    space = label_space()
    points = np.zeros(space.class_count, np.int64)
    points[1] = 5
    assert list(label_findings(points, 1.0, space)) == []
