# SPDX-License-Identifier: MIT
"""Points that `predict --reject` left unlabelled, so that nothing judges their error by that."""

from pathlib import Path

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float
from salsanext_cli.results.stage_records import settings_of


def rejected_above(out: Path) -> float | None:
    """Return the error above which the points in a folder were left unlabelled; None if none."""
    settings = settings_of(out, "predictions")
    return None if settings is None else settings.get("reject")


def rejected_points(out: Path, error: Float) -> npt.NDArray[np.bool_]:
    """Say of points, by their error (N,), which were left unlabelled for it."""
    above = rejected_above(out)
    return np.zeros(len(error), bool) if above is None else error > above
