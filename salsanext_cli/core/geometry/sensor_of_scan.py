# SPDX-License-Identifier: MIT
"""The sensor that saw a scan: the member of a fitted sensor, at the origin of the scan.

This is the only place that applies a fitted sensor to a scan.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.geometry.scan_traits import scaled_traits, traits_of
from salsanext_cli.core.geometry.sensor_frame import in_sensor_frame
from salsanext_cli.core.geometry.sensor_place import placed_sensor
from salsanext_cli.core.records import Origin, Scan
from salsanext_cli.core.sensors.sensor import Sensor


def sensor_of(scan: Scan, sensor: Sensor, origin: Origin | None = None) -> Sensor:
    """Return a fitted sensor as it saw a scan.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    sensor : Sensor
        Sensor that was fitted to such scans. Of several members, it is the one whose usual traits
        are most like those of the scan.
    origin : 3 floats, optional
        Position of a sensor of registered scans in the frame of the file, in metres; by default it
        is found from the points.

    Returns
    -------
    Sensor
        The member, whose origin is that of the scan if it is registered.
    """
    if not sensor.others:
        return _as_it_saw(scan, sensor, origin)
    return _likeliest_member(scan, sensor, origin).sensor


def member_of(scan: Scan, sensor: Sensor, origin: Origin | None = None) -> int:
    """Return the number of the member of a fitted sensor that saw a scan.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    sensor : Sensor
        Sensor that was fitted to such scans, perhaps with several members.
    origin : 3 floats, optional
        Position of the sensor in the scan in metres, if it is known.

    Returns
    -------
    int
        Number in `Sensor.members`.
    """
    return _likeliest_member(scan, sensor, origin).number if sensor.others else 0


def origin_of_scan(scan: Scan, sensor: Sensor, origin: Origin | None = None) -> Origin | None:
    """Return the origin of a scan that its member and its projection depend on.

    `sensor_of` with it returns the same member now and in later stages.

    Parameters
    ----------
    scan : Scan
        Scan in the frame of its file.
    sensor : Sensor
        Sensor that was fitted to such scans, perhaps with several members.
    origin : 3 floats, optional
        Position of the sensor in the scan in metres, if it is known.

    Returns
    -------
    tuple of float or None
        The requested origin, else that of the points, in metres; None unless scans of a member are
        registered.
    """
    if not sensor.has_registered or origin is not None:
        return origin
    return sensor_of(scan, sensor).origin


@dataclass(frozen=True, slots=True)
class _Member:
    """Member of a fitted sensor as it saw a scan."""

    number: int
    sensor: Sensor


def _as_it_saw(scan: Scan, member: Sensor, origin: Origin | None) -> Sensor:
    """Return a member with the origin of a scan if its scans are registered to a map."""
    if not member.registered:
        return member
    return placed_sensor(scan, member) if origin is None else replace(member, origin=origin)


def _likeliest_member(scan: Scan, sensor: Sensor, origin: Origin | None) -> _Member:
    """Return the member of a sensor whose usual traits are most like those of a scan.

    The traits of registered scans are those in the frame of the sensor.
    """
    members = [_as_it_saw(scan, member, origin) for member in sensor.members]
    in_file = traits_of(scan)
    if in_file is None:
        return _Member(0, members[0])
    scan_traits = []
    for member in members:
        in_frame = traits_of(in_sensor_frame(scan, member)) if member.registered else None
        scan_traits.append((in_frame or in_file).compared)
    member_traits = [member.traits for member in sensor.members]
    values = scaled_traits(scan_traits + member_traits)
    differences = np.abs(values[: len(members)] - values[len(members) :]).sum(axis=1)
    number = int(differences.argmin())
    return _Member(number, members[number])
