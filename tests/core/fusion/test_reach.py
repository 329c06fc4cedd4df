# SPDX-License-Identifier: MIT
"""The reach of the fusion has bounds."""

import pytest
from scans import refused

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fusion.reach import MAX_REACH, FusionReach


@pytest.mark.parametrize("bounds", [(0, 0), (5, 5), (MAX_REACH, 0)])
def test_reaches_within_the_bounds(bounds):
    reach = FusionReach(*bounds)
    assert (reach.reach, reach.movable_reach) == bounds


@pytest.mark.parametrize("bounds", [(-1, -1), (3, 4), (MAX_REACH + 1, 0), (4, -1)])
def test_reaches_beyond_the_bounds_are_refused(bounds):
    refused(UsageError, "reach and movable_reach", FusionReach, *bounds)
