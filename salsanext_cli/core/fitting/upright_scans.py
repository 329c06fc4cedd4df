# SPDX-License-Identifier: MIT
"""Upright scans, and where their sensor is by the points of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from salsanext_cli.core.geometry.beam_origin import PROVING_SHARPNESS, sharpness_at_origin
from salsanext_cli.core.geometry.evenness import is_even_fan, is_far, is_out_of_place
from salsanext_cli.core.geometry.ground import MIN_HEIGHT_M, UPWARDS, finite_points
from salsanext_cli.core.geometry.point_sample import few_points
from salsanext_cli.core.geometry.sensor_place import SensorPlace, find_place
from salsanext_cli.core.records import Float, Scan

SCANS_OF_ORIGIN = 4  # Scans that show the origin
POINTS_OF_ORIGIN = 8192  # Points of each of these
SHARPER = 1.1
"""Least factor between the sharpness of another position and of a sharp origin; scans of 32 beams
that were moved by 4 or 5 m had 1.18 or more."""
SHARPER_M = 0.5  # Least distance between them; correct scans had up to 0.35 m


def points_above_ground(upright: Sequence[Scan], height: float | None) -> Float:
    """Return points of the first upright scans without the ground.

    The ground has most points near the sensor.

    Parameters
    ----------
    upright : sequence of Scan
        Scans with z up, of which `SCANS_OF_ORIGIN` count.
    height : float, optional
        Height of the origin above the ground in metres; None keeps all points.

    Returns
    -------
    (N, 3) float32
        Finite coordinates in metres.
    """
    above = -np.inf if height is None else MIN_HEIGHT_M - height
    objects = [
        scan.take(np.flatnonzero(scan.points[:, UPWARDS] > above))
        for scan in upright[:SCANS_OF_ORIGIN]
    ]
    return np.concatenate([finite_points(few_points(scan, POINTS_OF_ORIGIN)) for scan in objects])


@dataclass(frozen=True, slots=True)
class UprightScans:
    """Upright scans, and the places of their sensor, each of which is searched once."""

    scans: Sequence[Scan]
    height: float | None = None  # Height of the origin above the ground in metres, if it is unusual
    all_doubtful: bool = False  # Whether no scan shows that its origin is at the sensor
    _uneven: dict[int, bool] = field(default_factory=dict, init=False)
    _places: dict[int, SensorPlace | None] = field(default_factory=dict, init=False)

    def is_doubtful(self, number: int) -> bool:
        """Return whether a scan may be seen from elsewhere than the origin."""
        return self.all_doubtful or self.is_uneven(number)

    def is_uneven(self, number: int) -> bool:
        """Return whether the points of a scan do not look as if seen from the origin."""
        if number not in self._uneven:
            self._uneven[number] = is_out_of_place(self.scans[number])
        return self._uneven[number]

    def place(self, number: int) -> SensorPlace | None:
        """Return the place of the sensor in a scan, None if it is unknown."""
        if number not in self._places:
            self._places[number] = find_place(self.scans[number])
        return self._places[number]

    def place_elsewhere(self, number: int) -> SensorPlace | None:
        """Return the place in a scan, None if it is unknown or the origin."""
        place = self.place(number)
        if place is None or not place.is_elsewhere:
            return None
        scan = self.scans[number]
        if is_even_fan(scan) and not (place.shows_beams or is_far(scan)):
            return None  # Positions within a fan see points all around.
        if self.is_uneven(number):
            return place
        return place if self._is_sharper(number, place) else None

    def _is_sharper(self, number: int, place: SensorPlace) -> bool:
        """Return whether beams do not rather start from the origin than from another place."""
        objects = points_above_ground([self.scans[number]], self.height)
        at_origin = sharpness_at_origin(objects)
        if at_origin <= PROVING_SHARPNESS:
            return True
        at_place = sharpness_at_origin(objects - place.position.astype(np.float32))
        is_apart = bool(np.linalg.norm(place.position) > SHARPER_M)
        return is_apart and at_place > SHARPER * at_origin
