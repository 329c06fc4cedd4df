# SPDX-License-Identifier: MIT
"""Groups of the scans of a folder by their sensors, also if some are registered to a map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.fitting.mounting_fit import REGISTERED_M
from salsanext_cli.geometry.evenness import is_out_of_place
from salsanext_cli.geometry.ground import UPWARDS
from salsanext_cli.geometry.projection import in_sensor_frame
from salsanext_cli.geometry.scan_traits import (
    ScanTraits,
    groups_of,
    kinds_of,
    traits_of,
    usual_traits,
)
from salsanext_cli.geometry.sensor_place import find_place
from salsanext_cli.records import Double, Scan
from salsanext_cli.sensors.sensor import UP, Sensor


@dataclass(frozen=True, slots=True)
class SensorGroup:
    """Scans of one sensor."""

    numbers: tuple[int, ...]  # Places of the scans among all, in their order
    traits: tuple[float, ...]  # Usual traits; in the frame of the sensor if it moves in the files


@dataclass(frozen=True, slots=True)
class _SeenScan:
    """Scan in the frame of its sensor."""

    number: int  # Its place among all scans
    traits: ScanTraits
    position: Double  # (3,): where the sensor is in the frame of the file, metres
    is_moved: bool  # Whether the scan does not look as if seen from the origin


def sensor_groups(scans: Sequence[Scan], sensor: Sensor) -> list[SensorGroup]:
    """Return the groups of scans (F scans) by their sensors, the largest first.

    Scans in the frame of a map differ among each other as those of many sensors do. So they are
    compared in the frame of their sensor, and belong together if it moves.

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
    seen = [view for number, scan in enumerate(scans) if (view := _seen(number, scan, sensor))]
    moving = _moving_groups(seen)
    registered = {number for group in moving for number in group.numbers}
    others = [number for number in range(len(scans)) if number not in registered]
    fixed = _groups_in_file([scans[number] for number in others], others) if moving else groups
    return sorted([*moving, *fixed], key=lambda group: -len(group.numbers))


def _groups_in_file(scans: Sequence[Scan], numbers: Sequence[int]) -> list[SensorGroup]:
    """Return the groups of scans with these places among all, by their traits in the files."""
    kinds, traits = kinds_of(scans)
    members: list[list[int]] = [[] for _ in traits]
    for number, kind in zip(numbers, kinds, strict=True):
        if members:
            members[kind].append(number)
    return [SensorGroup(tuple(group), usual) for group, usual in zip(members, traits, strict=True)]


def _seen(number: int, scan: Scan, sensor: Sensor) -> _SeenScan | None:
    """Return the traits of a scan in the frame of its sensor, None if nothing shows its place."""
    place = find_place(scan)
    if place is None:
        return None
    up = UP if place.up[UPWARDS] > 0 else (0.0, 0.0, -1.0)
    there = replace(sensor, up=up, origin=tuple(place.position.tolist()))
    traits = traits_of(in_sensor_frame(scan, there))
    if traits is None:
        return None
    is_moved = place.is_elsewhere and is_out_of_place(scan)
    return _SeenScan(number, traits, place.position, is_moved)


def _moving_groups(seen: Sequence[_SeenScan]) -> list[SensorGroup]:
    """Return the groups of scans whose sensor moves, with its scans at the origin."""
    moved = [view for view in seen if view.is_moved]
    at_origin = [view for view in seen if not view.is_moved]
    kinds = groups_of([view.traits for view in moved])
    groups = []
    for kind in sorted({*kinds}):
        members = [view for view, other in zip(moved, kinds, strict=True) if other == kind]
        traits = [view.traits for view in members]
        members += [view for view in at_origin if {*groups_of([*traits, view.traits])} == {0}]
        if _moves(members):
            numbers = sorted(view.number for view in members)
            groups.append(SensorGroup(tuple(numbers), usual_traits(traits)))
            at_origin = [view for view in at_origin if view.number not in numbers]
    return groups


def _moves(seen: Sequence[_SeenScan]) -> bool:
    """Return whether the positions of a sensor differ among its scans."""
    positions = np.array([view.position for view in seen])[:, :UPWARDS]
    distances = np.hypot(*(positions - np.median(positions, axis=0)).T)
    return bool(distances.max() > REGISTERED_M)
