# SPDX-License-Identifier: MIT
"""Field of view, mounting and vehicle of the sensors of a sample of scans."""

import logging
from collections.abc import Sequence
from dataclasses import fields, replace

import numpy as np

from salsanext_cli.core.fitting.ego_fit import MIN_SCANS, fit_ego
from salsanext_cli.core.fitting.field_of_view import fit_view
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.fitting.sensor_groups import SensorGroup, sensor_groups
from salsanext_cli.core.fitting.sensor_texts import view_text
from salsanext_cli.core.notices import NOTICE, result_level
from salsanext_cli.core.sensors.sensor import FIELD_OF_VIEW, FittedView, Sensor
from salsanext_cli.core.texts import counted
from salsanext_cli.core.wording import argument

log = logging.getLogger(__name__)

VIEW_TOLERANCES = {"fov_up": 5.0, "fov_down": 5.0, "up": 0.1, "origin": 0.5}
"""Largest differences, in degrees, of a unit vector, in metres, of fits to scans of one sensor."""
EGO = ("min_range", "ego_box")  # Fields that are always fitted where they are None


def fit_views(
    sample: ScanSample,
    sensor: Sensor,
    earlier: Sensor | None = None,
    *,
    view: bool = True,
    mounting: bool = True,
) -> Sensor:
    """Return a sensor fitted to a sample of scans, with a member for each sensor of the scans.

    Parameters
    ----------
    sample : ScanSample
        Scans that the fit reads, if it needs any.
    sensor : Sensor
        Sensor to start from.
    earlier : Sensor, optional
        Fit for earlier results in the same folder, which stays.
    view : bool
        Whether to fit the field of view; unknown bounds of housing and vehicle are always fitted.
    mounting : bool
        Whether to fit the mounting with the field of view.

    Returns
    -------
    Sensor
        Fit to the scans of the most frequent sensor; `others` has the fits to the other scans.
    """
    before = earlier if earlier and earlier.others else sensor
    if not before.others and (earlier or len(sample.sources) < 2):
        return _fitted_view(sample, sensor, earlier, view=view, mounting=mounting)
    groups = _groups_of_members(sample, before) if before.others else None
    if groups is None:
        groups = sensor_groups(sample.scans, sensor)
    if len(groups) < 2:
        return _fitted_view(sample, sensor, earlier, view=view, mounting=mounting)
    fits = []
    for number, group in enumerate(groups):
        announce_member(sample, group.numbers, number, len(groups))
        member = sensor.members[number] if sensor.others else sensor
        member_before = earlier.members[number] if earlier and earlier.others else earlier
        fit = _fitted_view(
            sample.subset(group.numbers), member, member_before, view=view, mounting=mounting
        )
        fits.append(replace(fit, traits=group.traits))
    return replace(fits[0], others=tuple(fits[1:]))


def _groups_of_members(sample: ScanSample, sensor: Sensor) -> list[SensorGroup]:
    """Return the scans of each member of the sensor of earlier results or of range images."""
    numbers = sample.members_of_scans(sensor)
    groups = []
    for number, member in enumerate(sensor.members):
        places = tuple(place for place, other in enumerate(numbers) if other == number)
        groups.append(SensorGroup(places, member.traits))
    return groups


def announce_member(sample: ScanSample, places: Sequence[int], number: int, count: int) -> None:
    """Log the scans of one of several sensors.

    Parameters
    ----------
    sample : ScanSample
        Scans of all sensors.
    places : sequence of int
        Places of the scans of the sensor in the sample.
    number : int
        Number of the sensor, from 0.
    count : int
        Number of sensors.
    """
    if places:
        scans = counted(len(places), "scan")
        name = sample.read[places[0]].source.name
        log.log(NOTICE, "sensor %d of %d: %s, such as %s", number + 1, count, scans, name)


def _fitted_view(
    sample: ScanSample, sensor: Sensor, earlier: Sensor | None, *, view: bool, mounting: bool
) -> Sensor:
    """Do what `fit_views` does for the scans of one sensor."""
    unknown = [name for name in EGO if getattr(sensor, name) is None]
    if not (view or unknown):
        return sensor
    if earlier is not None:
        names = list(unknown)
        if view and mounting:
            names += [field.name for field in fields(FittedView)] + ["registered"]
        elif view:
            names += FIELD_OF_VIEW
        return replace(sensor, **{name: getattr(earlier, name) for name in names})
    scans = sample.scans
    fitted = fit_view(scans, sensor, mounting=mounting) if view else fit_ego(scans, sensor)
    count = counted(len(scans), "scan")
    if replace(fitted, **{name: getattr(sensor, name) for name in EGO}) != sensor:
        log.log(NOTICE, "sensor fitted to %s: %s", count, view_text(fitted))
    if sensor.ego_box is None and 0 < len(scans) < MIN_SCANS and not fitted.registered:
        text = "own vehicle not searched for in %s: that needs %d of one drive, or %s with its box"
        log.log(result_level(), text, count, MIN_SCANS, argument("ego"))
    return fitted


def fit_sensor(
    sample: ScanSample,
    sensor: Sensor,
    earlier: Sensor | None = None,
    *,
    view: bool = True,
    mounting: bool = True,
) -> Sensor:
    """Return a sensor fitted to a sample of scans; equal members are one.

    Parameters
    ----------
    sample : ScanSample
        Scans that the fit reads, if it needs any.
    sensor : Sensor
        Sensor to start from.
    earlier : Sensor, optional
        Fit for earlier results in the same folder, which stays.
    view : bool
        Whether to fit the field of view; unknown bounds of housing and vehicle are always fitted.
    mounting : bool
        Whether to fit the mounting with the field of view.

    Returns
    -------
    Sensor
        Of the most frequent sensor; `others` has the other fits, unless all are alike.
    """
    return joined(fit_views(sample, sensor, earlier, view=view, mounting=mounting).members)


def joined(members: Sequence[Sensor]) -> Sensor:
    """Return the sensor of all members, a single one if the fits to them are alike."""
    if len({replace(member, traits=(), others=()) for member in members}) == 1:
        return replace(members[0], traits=(), others=())
    return replace(members[0], others=tuple(members[1:]))


def is_other_view(view: FittedView, sensor: Sensor) -> bool:
    """Return whether a sensor differs from a fitted one by more than `VIEW_TOLERANCES`."""
    other = FittedView.from_sensor(sensor)
    if other.name != view.name:
        return True
    for name, tolerance in VIEW_TOLERANCES.items():
        difference = np.subtract(getattr(other, name), getattr(view, name))
        if np.abs(difference).max() > tolerance:
            return True
    return False
