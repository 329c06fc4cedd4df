# SPDX-License-Identifier: MIT
"""Mixing of two labelled scans into one, on points, before projecting.

The nearest point then wins each pixel whichever scan it is from, and range, x, y and z of the range
image stay consistent. Sources: LaserMix (Kong et al. 2023) alternates two scans band by
band of inclination, PolarMix (Xiao et al. 2022) sector by sector of azimuth, RangeFormer (Kong et
al. 2023) box by box of the range image; the last two add points of rare classes of another scan.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.records import Float, Scan
from salsanext_cli.sensors import Sensor
from salsanext_cli.training.augment import LabelledScan, rotate

KINDS = ((True, False), (False, True), (True, True))
"""Kinds of checkerboards, of several bands or sectors or both: LaserMix, PolarMix, boxes."""
MIN_BANDS, MAX_BANDS = 2, 6
MAX_SECTOR_PAIRS = 3
PASTED_COPIES = 2
"""Number of times that rare points are pasted, each time turned by another angle."""
CLEAR_RADIUS_M = 3.0
"""Radius in metres around the sensor where nothing is pasted: the vehicle is there."""


@dataclass(frozen=True, slots=True)
class Checkerboard:
    """Checkerboard over the directions in which a sensor looks.

    Cell (i, j) is band i of inclination, from below, and sector j of azimuth, counter-clockwise; it
    is odd if i + j is.

    Attributes
    ----------
    bands : int
        Equally high, from the lower edge of the field of view to the upper. The outer ones hold
        the points beyond, too.
    sectors : int
        Equally wide; 1 or an even number, so that neighbours differ all around the circle.
    azimuth : float
        End of the first sector, in radians.
    fov_down, fov_up : float
        Edges of the field of view in degrees.
    """

    bands: int
    sectors: int
    azimuth: float
    fov_down: float
    fov_up: float

    @classmethod
    def drawn(cls, sensor: Sensor, random: np.random.Generator) -> Self:
        """Draw bands, sectors or boxes, all three as often, their number and azimuth."""
        in_bands, in_sectors = KINDS[random.integers(len(KINDS))]
        bands = int(random.integers(MIN_BANDS, MAX_BANDS + 1)) if in_bands else 1
        sectors = 2 * int(random.integers(1, MAX_SECTOR_PAIRS + 1)) if in_sectors else 1
        return cls(bands, sectors, random.uniform(-np.pi, np.pi), sensor.fov_down, sensor.fov_up)

    def odd(self, points: Float) -> npt.NDArray[np.bool_]:
        """Return whether points (N, 3) lie in odd cells, (N,) bool.

        It changes with every border that lies between a point and the lowest band of the first
        sector. A border between bands is a cone; one between sectors goes on straight through the
        origin as another, so that half as many planes are borders of all sectors.
        """
        x, y, z = np.ascontiguousarray(points.T)
        odd = np.zeros(len(points), np.bool_)
        edges = np.radians(np.linspace(self.fov_down, self.fov_up, self.bands + 1)[1:-1])
        width = 2 * math.pi / self.sectors
        # Points without a measurement may end up anywhere, since no pixel shows them.
        with np.errstate(invalid="ignore", over="ignore"):
            flat = np.sqrt(x * x + y * y)
            for inclination in edges:
                odd ^= z > flat * np.float32(math.tan(inclination))
            for plane in range(self.sectors // 2):
                angle = self.azimuth + plane * width
                odd ^= y * np.float32(math.cos(angle)) > x * np.float32(math.sin(angle))
        return odd


def mix(even: LabelledScan, odd: LabelledScan, board: Checkerboard) -> LabelledScan:
    """Return the points of one scan in the even cells of a board, of another in the odd ones."""
    return concatenate(
        select(even, ~board.odd(even[0].points)),
        select(odd, board.odd(odd[0].points)),
    )


def paste(
    onto: LabelledScan, pasted: LabelledScan, angles: npt.NDArray[np.float64]
) -> LabelledScan:
    """Return a scan and, for each angle (radians), all points of another turned about z by it.

    Points within `CLEAR_RADIUS_M` of the z axis, or without a measurement, are not pasted.
    """
    points = pasted[0].points
    with np.errstate(invalid="ignore", over="ignore"):
        clear = np.hypot(points[:, 0], points[:, 1]) > CLEAR_RADIUS_M
    scan, labels = select(pasted, clear & np.isfinite(points).all(axis=1))
    turned = [(Scan(rotate(scan.points, angle), scan.intensity), labels) for angle in angles]
    return concatenate(onto, *turned)


def select(labelled: LabelledScan, chosen: npt.NDArray[np.bool_]) -> LabelledScan:
    """Return the chosen points of a labelled scan, (N,) bool."""
    scan, labels = labelled
    # By index it takes a fifth of the time that NumPy needs by mask.
    index = np.flatnonzero(chosen)
    return Scan(scan.points.take(index, 0), scan.intensity.take(index)), labels.take(index)


def concatenate(*scans: LabelledScan) -> LabelledScan:
    """Return the points of all scans, in their order."""
    points = np.concatenate([scan.points for scan, _ in scans])
    intensity = np.concatenate([scan.intensity for scan, _ in scans])
    return Scan(points, intensity), np.concatenate([labels for _, labels in scans])
