# SPDX-License-Identifier: MIT
"""Numbers as people read them."""

from __future__ import annotations

import math

ABSENT = "–"


def percent(share: float, digits: int = 1, unit: str = "") -> str:
    """Return a share as a number of percent; "–" for NaN."""
    return ABSENT if math.isnan(share) else f"{100 * share:.{digits}f}{unit}"
