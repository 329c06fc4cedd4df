# SPDX-License-Identifier: MIT
"""Local frame of map coordinates, whose digits float32 would round."""

import numpy as np

from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Double, Origin

CELL_M = 10_000.0
"""Distance of the possible origins; coordinates of up to half of it keep 0.25 mm in float32."""
NO_SHIFT: Origin = (0.0, 0.0, 0.0)  # Frame of files around their sensor


def local_frame(points: Double) -> Origin:
    """Return the origin of the local frame of a cloud, in the coordinates of its file.

    It is the corner of a grid nearest to the median of the points, so that the clouds of a site
    have the same one, and stray points do not count. That of a cloud around its sensor is the
    origin of the file. Heights stay.

    Parameters
    ----------
    points : (N, 3) float64
        Coordinates in metres. Points that are not finite or at the origin are no measurements.

    Returns
    -------
    3 floats
        In metres; `NO_SHIFT` without a measurement.
    """
    measured = points[np.isfinite(points).all(axis=1) & points.any(axis=1), :2]
    if not len(measured):
        return NO_SHIFT
    half = (len(measured) - 1) // 2
    # A median between two points could be far from both.
    median = np.partition(measured, half, axis=0)[half]
    x, y = (CELL_M * np.rint(median / CELL_M) + 0.0).tolist()
    return (x, y, 0.0)


def notice_frame(frame: Origin) -> None:
    """Print a notice about points that are moved into a local frame, once for each frame."""
    if frame != NO_SHIFT:
        x, y, _ = frame
        notice_once(
            f"map coordinates are moved into a local frame: {x:.0f} m are subtracted from x, "
            f"{y:.0f} m from y"
        )
