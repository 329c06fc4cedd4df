# SPDX-License-Identifier: MIT
"""Shadow of the recording vehicle: the rays that it blocks."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.synthesis.mesh import Rng
from salsanext_cli.synthesis.presets import VEHICLE_OUTLINES_DEG
from salsanext_cli.synthesis.sensor.beams import Beams

PARALLAX_DEG = 1.2
"""Shift of the vehicle as seen by lasers to the left and right of the axis."""


def hidden_by_vehicle(beams: Beams, rng: Rng) -> npt.NDArray[np.bool_]:
    """Return the rays that the recording vehicle blocks, (L * columns,); mounting varies a bit."""
    azimuth = np.degrees(beams.azimuths()) + PARALLAX_DEG * np.sign(beams.aside)[:, None]
    elevation = np.degrees(beams.elevation)[:, None]
    hidden = np.zeros(azimuth.shape, bool)
    for outline in VEHICLE_OUTLINES_DEG:
        corner, upper, lower = outline.T
        beyond = np.mod(azimuth - corner[0] - rng.normal(0, 0.3), 360)
        shift = rng.normal(0, 0.3)
        below = elevation < np.interp(beyond, corner - corner[0], upper, right=-90) + shift
        hidden |= below & (elevation > np.interp(beyond, corner - corner[0], lower, right=-90))
    return hidden.reshape(-1)
