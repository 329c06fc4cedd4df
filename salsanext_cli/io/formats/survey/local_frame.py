# SPDX-License-Identifier: MIT
"""Local frame of map coordinates, whose digits float32 would round."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.notices import notice_once
from salsanext_cli.core.records import Origin

CELL_M = 10_000.0
"""Distance of the possible origins; coordinates of up to half of it keep 0.25 mm in float32."""
NO_SHIFT: Origin = (0.0, 0.0, 0.0)  # Frame of files around their sensor


def local_frame(least: npt.ArrayLike, largest: npt.ArrayLike) -> Origin:
    """Return the origin of the local frame of a cloud, in the coordinates of its file.

    It is the nearest corner of a grid, so that the clouds of a site have the same one. That of a
    cloud around its sensor is the origin of the file. Heights stay.

    Parameters
    ----------
    least, largest : (3,) array
        Bounds of the coordinates in metres.

    Returns
    -------
    3 floats
        In metres; `NO_SHIFT` for bounds that are not finite.
    """
    bounds = np.array([least, largest], np.float64)
    if not np.isfinite(bounds).all():
        return NO_SHIFT
    middle = bounds.mean(axis=0)
    x, y = (CELL_M * np.rint(middle[:2] / CELL_M) + 0.0).tolist()
    return (x, y, 0.0)


def notice_frame(frame: Origin) -> None:
    """Print a notice about points that are moved into a local frame, once for each frame."""
    if frame != NO_SHIFT:
        x, y, _ = frame
        notice_once(
            f"map coordinates are moved into a local frame: {x:.0f} m are subtracted from x, "
            f"{y:.0f} m from y"
        )
