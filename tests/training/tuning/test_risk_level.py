# SPDX-License-Identifier: MIT
"""A level of risk needs as many scans as the bounds of the guarantee do."""

import re

import pytest
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.risk_control import needed_scans, share_left, useful_scans
from salsanext_cli.training.tuning.risk_level import (
    FewUnits,
    RiskLevel,
    TooFewScansError,
    require_scans,
)

LEVELS = [(0.05, None), (0.3, None), (0.1, 0.5), (0.1, 0.9), (0.1, 0.99)]


def level_of(numbers: tuple[float, float | None]) -> RiskLevel:
    at_most, confidence = numbers
    return RiskLevel(at_most=at_most, confidence=confidence)


@pytest.mark.parametrize("at_most", [0, 1, -0.1, 1.5, float("nan")])
def test_shares_outside_their_range_are_refused(at_most):
    refused(UsageError, "at_most", RiskLevel(at_most=at_most).require_possible)


@pytest.mark.parametrize("confidence", [0.49, 1, 0, float("nan")])
def test_confidences_outside_their_range_are_refused(confidence):
    refused(
        UsageError, "confidence", RiskLevel(at_most=0.1, confidence=confidence).require_possible
    )


@pytest.mark.parametrize("level", LEVELS)
def test_the_least_number_of_scans_is_enough_and_one_less_is_not(level, tmp_path):
    least = needed_scans(*level)
    require_scans(tmp_path, least, level_of(level))
    refused(TooFewScansError, tmp_path, require_scans, tmp_path, least - 1, level_of(level))


@pytest.mark.parametrize("scans", [3, 8, 18])
def test_the_proposed_level_leaves_half_of_it_for_wrong_points(scans, tmp_path):
    with pytest.raises(TooFewScansError) as caught:
        require_scans(tmp_path, scans, RiskLevel(at_most=0.01))
    proposed = float(re.search(r"at_most=([\d.]+)", caught.value.hint)[1])
    assert share_left(scans, proposed) == pytest.approx(proposed / 2, abs=0.001)


@pytest.mark.parametrize("level", LEVELS)
def test_few_units_leave_less_than_the_level(level):
    """The closed form of the bound of the mean is level − (1 − level) / n."""
    at_most, confidence = level
    least, useful = needed_scans(*level), useful_scans(*level)
    assert FewUnits.among(useful, "scan", level_of(level)) is None
    few = FewUnits.among(least, "scan", level_of(level))
    if useful == least:
        assert few is None
        return
    assert few.useful == useful
    assert 0 <= few.left < at_most
    if confidence is None:
        assert few.left == pytest.approx(at_most - (1 - at_most) / least)


def test_the_warnings_state_what_more_scans_would_do(caplog):
    few = FewUnits.among(needed_scans(0.05, None), "drive", RiskLevel(at_most=0.05))
    few.warn_before()
    few.warn_after(0.25, 0.6)
    before, after = caplog.messages
    assert before.startswith(f"{few.count} drives")
    assert "25.0 %" in after
    assert "60 %" in after
    assert f"{few.useful - few.count} more drive" in before
