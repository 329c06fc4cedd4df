# SPDX-License-Identifier: MIT
"""Sectors of the directions around a sensor, as seen from above."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.records import Indices

SECTORS = 64  # Equal parts of the circle


def sector_of_points(points: npt.NDArray[np.floating[Any]]) -> Indices:
    """Return the sector of each point.

    Parameters
    ----------
    points : (N, 3) floating
        Points in metres in the frame of the sensor.

    Returns
    -------
    (N,) intp
        Number of the sector, from 0 at the negative x axis, against the clock.
    """
    turns = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
    sectors: Indices = (turns * SECTORS).astype(np.intp) % SECTORS
    return sectors


def occupied_sectors(points: npt.NDArray[np.floating[Any]]) -> float:
    """Return the share of the sectors, 0…1, that contain one of the points (N, 3)."""
    return int(np.count_nonzero(np.bincount(sector_of_points(points)))) / SECTORS
