# SPDX-License-Identifier: MIT
"""Numbers of all scans of a run, for the scripts of its page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.measures.scores import Counts
from salsanext_cli.report.page.clouds import base64_of
from salsanext_cli.report.page.mean_uncertainty import is_share
from salsanext_cli.report.page.run_results import RunResults


def drive_data(
    run: RunResults, class_points: Counts, shown: Sequence[str], thumbnails: Mapping[str, str]
) -> dict[str, object]:
    """Return the numbers of all scans as base64 of float32, empty where unknown.

    Parameters
    ----------
    run : RunResults
        Scans of the run.
    class_points : ndarray of int64 (S, C)
        Number of points by predicted train id of each scan.
    shown : sequence of str
        Names of the scans that the page can show point by point.
    thumbnails : mapping of str to str
        Pictures of some scans, as addresses for `img`, by name.

    Returns
    -------
    dict
    """
    rows = run.rows
    places = {name: place for place, name in enumerate(shown)}
    kind = run.leading_kind or ""
    points = np.array([row.points for row in rows])
    shares = class_points / np.maximum(class_points.sum(axis=1, keepdims=True), 1)
    doubtful = [row.errors.doubtful_share for row in rows]
    is_rejected = any(row.rejected.rejected for row in rows)
    rejected = np.array([row.rejected.share for row in rows])
    codes = run.codes
    return {
        "names": [row.file.name for row in rows],
        "sequences": [row.file.sequence for row in rows],
        "shown": [places.get(row.file.name, -1) for row in rows],
        "kind": kind,
        "is_share": is_share(kind),
        "judged": run.judged_points,
        "points": points.tolist(),
        "codes": [codes[row.file.name] for row in rows],
        "thumbnails": [thumbnails.get(row.file.name, "") for row in rows],
        "uncertainty": _floats(np.array([row.uncertainty.get(kind, np.nan) for row in rows])),
        "wrong": _floats(np.array([row.wrong for row in rows])),
        "doubtful": _floats(np.array([np.nan if d is None else d for d in doubtful])),
        "rejected": _floats(rejected) if is_rejected else "",
        "shares": base64_of(shares, "<f4") if class_points.any() else "",
    }


def _floats(values: npt.NDArray[np.float64]) -> str:
    """Return numbers as base64 of float32; empty if none is known."""
    return "" if np.isnan(values).all() else base64_of(values, "<f4")
