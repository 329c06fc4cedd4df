# SPDX-License-Identifier: MIT
"""HDL-64E: 64 lasers in two blocks, about 2160 firings of each per revolution."""

import numpy as np

from salsanext_cli.synthesis.mesh import Array, Rng
from salsanext_cli.synthesis.sensor.beams import Beams

UPPER_BLOCK, LOWER_BLOCK = (2.4, -8.0, 32), (-8.6, -23.9, 32)
"""Elevation of the first and the last beam of a block in degrees, and their number."""
AZIMUTH_STEP_DEG = 0.1667
"""Angle between firings of a laser at 10 Hz."""


def lasers(rng: Rng, count: int) -> tuple[Array, Array, Array]:
    """Return gain, offset and power of lasers; a few report much less than others."""
    gain = rng.normal(1, 0.08, count)
    offset = np.abs(rng.normal(0, 0.012, count))
    weak = rng.random(count) < 0.1
    offset[weak] += rng.uniform(0.03, 0.2, int(weak.sum()))
    return gain, offset, np.exp(rng.normal(0, 0.5, count))


def hdl64(rng: Rng) -> Beams:
    """Return the beams of one HDL-64E with its own small deviations."""
    elevation = np.concatenate([np.linspace(*UPPER_BLOCK), np.linspace(*LOWER_BLOCK)])
    elevation = elevation + rng.normal(0, 0.045, 64) + rng.normal(0, 0.06)
    columns = round(360 / (AZIMUTH_STEP_DEG + rng.normal(0, 0.0006)))
    return Beams(
        np.radians(np.sort(elevation)[::-1]),
        rng.uniform(0, 2 * np.pi / columns, 64),
        np.repeat([0.05, 0.0], 32) + rng.normal(0, 0.003, 64),
        np.tile([0.026, -0.026], 32),
        *lasers(rng, 64),
        columns,
    )
