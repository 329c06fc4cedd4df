# SPDX-License-Identifier: MIT
"""Elevations of the beams of a sensor."""

from itertools import pairwise

from salsanext_cli.settings_files import are_numbers

MAX_BEAMS = 256
BEAMS_EXPECTED = f"2 to {MAX_BEAMS} elevations in degrees that fall from 90 to -90"


def are_beams(elevations: tuple[float, ...]) -> bool:
    """Say whether numbers can be the elevations of beams in degrees, top first; none can."""
    if not isinstance(elevations, tuple) or not are_numbers(elevations):
        return False
    fall = all(upper > lower for upper, lower in pairwise((90.1, *elevations, -90.1)))
    return not elevations or (fall and 2 <= len(elevations) <= MAX_BEAMS)
