# SPDX-License-Identifier: MIT
"""Groups of the scans of a folder by their sensors, also if some are registered to a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.fitting.mounting_fit import REGISTERED_M
from salsanext_cli.core.geometry.evenness import is_fan, is_out_of_place
from salsanext_cli.core.geometry.ground import UPWARDS
from salsanext_cli.core.geometry.scan_traits import (
    ScanTraits,
    groups_of,
    kinds_of,
    median_traits,
    traits_of,
)
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_place import find_place
from salsanext_cli.core.records import Double, Scan
from salsanext_cli.core.sensors.sensor import UP, Sensor


@dataclass(frozen=True, slots=True)
class SensorGroup:
    """Scans of one sensor."""

    numbers: tuple[int, ...]  # Places of the scans among all, in their order
    traits: tuple[float, ...]  # Usual traits; in the frame of the sensor if it moves in the files


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _PlacedScan:
    """Scan in the frame of its sensor."""

    number: int  # Its place among all scans
    traits: ScanTraits
    position: Double  # (3,): where the sensor is in the frame of the file, metres
    is_moved: bool  # Whether the scan does not look as if seen from the origin


def sensor_groups(scans: Sequence[Scan], sensor: Sensor) -> list[SensorGroup]:
    """Return the groups of scans (F scans) by their sensors, the largest first.

    Scans in the frame of a map differ among each other as those of many sensors do. So they belong
    together if their sensor moves, unless numbers of points or intensities differ: elevations
    depend on the tilt of the vehicle, which a map does not follow.

    Parameters
    ----------
    scans : sequence of Scan
        Scans in the frames of their files.
    sensor : Sensor
        Sensor whose mounting is not known yet.

    Returns
    -------
    list of SensorGroup
    """
    groups = _groups_in_file(scans, range(len(scans)))
    if len(groups) < 2 or not any(map(is_out_of_place, scans)):
        return groups
    placed_scans = [_placed_scan(number, scan, sensor) for number, scan in enumerate(scans)]
    moving_groups = _moving_groups([placed for placed in placed_scans if placed])
    if not moving_groups:
        return groups
    registered = {number for group in moving_groups for number in group.numbers}
    others = [number for number in range(len(scans)) if number not in registered]
    fixed_groups = _groups_in_file([scans[number] for number in others], others)
    return sorted([*moving_groups, *fixed_groups], key=lambda group: -len(group.numbers))


def _groups_in_file(scans: Sequence[Scan], numbers: Sequence[int]) -> list[SensorGroup]:
    """Return the groups of scans with these places among all, by their traits in the files.

    There is none if no scan shows traits.
    """
    kinds, traits = kinds_of(scans)
    if not traits:
        return []
    members: list[list[int]] = [[] for _ in traits]
    for number, kind in zip(numbers, kinds, strict=True):
        members[kind].append(number)
    pairs = zip(members, traits, strict=True)
    return [SensorGroup(tuple(group), medians) for group, medians in pairs]


def _placed_scan(number: int, scan: Scan, sensor: Sensor) -> _PlacedScan | None:
    """Return a scan in the frame of its sensor, None if its place or its traits do not show.

    A scan all around that is seen from elsewhere has the best place, even if nothing proves it.
    """
    is_seen_from_elsewhere = is_out_of_place(scan)
    place = find_place(scan, verified=not is_seen_from_elsewhere or is_fan(scan))
    if place is None:
        return None
    up = UP if place.up[UPWARDS] > 0 else (0.0, 0.0, -1.0)
    sensor_at_place = replace(sensor, up=up, origin=tuple(place.position.tolist()))
    traits = traits_of(in_sensor_frame(scan, sensor_at_place))
    if traits is None:
        return None
    is_far = bool(place.distance_aside > REGISTERED_M)
    is_moved = place.is_elsewhere and (is_seen_from_elsewhere or is_far)
    return _PlacedScan(number=number, traits=traits, position=place.position, is_moved=is_moved)


def _moving_groups(placed_scans: Sequence[_PlacedScan]) -> list[SensorGroup]:
    """Return the groups of scans whose sensor moves, with its scans at the origin.

    Moved scans of no such group belong to the one with the most similar number of points.
    """
    moved = [placed for placed in placed_scans if placed.is_moved]
    at_origin = [placed for placed in placed_scans if not placed.is_moved]
    kinds = groups_of([_without_elevations(placed.traits) for placed in moved])
    moved_by_kind: list[list[_PlacedScan]] = [[] for _ in set(kinds)]
    for placed, kind in zip(moved, kinds, strict=True):
        moved_by_kind[kind].append(placed)
    moving: list[list[_PlacedScan]] = []
    single: list[_PlacedScan] = []
    for members in moved_by_kind:
        with_origin = members + _like_any(members, at_origin)
        if not _moves(with_origin):
            single += members
            continue
        moving.append(with_origin)
        at_origin = [placed for placed in at_origin if placed not in with_origin]
    if not moving:
        return []
    numbers = [[placed.number for placed in members] for members in moving]
    points = np.log([np.median([placed.traits.points for placed in members]) for members in moving])
    for placed in single:
        nearest = int(np.abs(points - np.log(placed.traits.points)).argmin())
        numbers[nearest].append(placed.number)
    groups = []
    for members, group_numbers in zip(moving, numbers, strict=True):
        traits = median_traits([placed.traits for placed in members])
        groups.append(SensorGroup(tuple(sorted(group_numbers)), traits))
    return groups


def _without_elevations(traits: ScanTraits) -> ScanTraits:
    """Return traits that differ by number of points and intensity alone."""
    return replace(traits, below=(0.0,) * len(traits.below))


def _like_any(
    members: Sequence[_PlacedScan], at_origin: Sequence[_PlacedScan]
) -> list[_PlacedScan]:
    """Return the scans at the origin whose traits are like those of a member of a group."""
    traits = [placed.traits for placed in members]
    alike = []
    for placed in at_origin:
        kinds = groups_of([*traits, placed.traits])
        if kinds[-1] in kinds[:-1]:
            alike.append(placed)
    return alike


def _moves(members: Sequence[_PlacedScan]) -> bool:
    """Return whether the positions of a sensor differ among its scans."""
    positions = np.array([placed.position for placed in members])[:, :UPWARDS]
    aside = positions - np.median(positions, axis=0)
    distances = np.hypot(aside[:, 0], aside[:, 1])
    return bool(distances.max() > REGISTERED_M)
