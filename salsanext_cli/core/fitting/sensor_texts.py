# SPDX-License-Identifier: MIT
"""Texts about a fitted sensor: its vehicle, its range images, its field of view and mounting."""

from salsanext_cli.core.sensors.sensor import FITTED_NAME, ORIGIN, UP, Sensor


def ego_text(sensor: Sensor) -> str:
    """Describe the region of the vehicle: ``nearer than 1 m, or in x -0.6…0.7, …``."""
    near = f"nearer than {sensor.min_range or 0:g} m"
    box = sensor.ego_box
    if not box:
        return near
    least = box[:3]
    largest = box[3:]
    sides = [f"{axis} {a:g}…{b:g}" for axis, a, b in zip("xyz", least, largest, strict=True)]
    return f"{near}, or in {', '.join(sides)} m"


def image_text(sensor: Sensor, trained: Sensor | None = None) -> str:
    """Describe the range images: ``64×512, field of view +3° to -25° (of the weights)``.

    Parameters
    ----------
    sensor : Sensor
        Sensor of the images.
    trained : Sensor, optional
        Sensor of the weights, to state where the field of view is from.

    Returns
    -------
    str
    """
    text = f"{sensor.height}×{sensor.width}, {view_text(sensor)}"
    if trained is None:
        return text
    if view_text(sensor) == view_text(trained):
        return f"{text} (of the weights)"
    if sensor.name not in (trained.name, FITTED_NAME):
        return f"{text} (sensor {sensor.name})"
    is_view_kept = (sensor.fov_up, sensor.fov_down) == (trained.fov_up, trained.fov_down)
    return f"{text} ({'mounting fitted' if is_view_kept else 'fitted'})"


def view_text(sensor: Sensor) -> str:
    """Describe field of view and mounting: ``field of view +10.7° to -30.7°, up …``."""
    up = "" if sensor.up == UP else f", up {sensor.up}"
    origin = "" if sensor.origin == ORIGIN else f", origin {sensor.origin}"
    registered = ", an origin for each scan" if sensor.registered else ""
    return f"field of view {sensor.fov_up:+g}° to {sensor.fov_down:+g}°{up}{origin}{registered}"
