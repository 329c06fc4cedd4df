# SPDX-License-Identifier: MIT
"""Sensor that is requested by a name and changes of single fields."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.texts import quoted
from salsanext_cli.core.wording import argument

TYPE_CHECKING = False  # Importing it from `typing` takes time.
if TYPE_CHECKING:
    from collections.abc import Callable

    from salsanext_cli.core.records import Origin
    from salsanext_cli.core.sensors.sensor import Sensor

AUTO = "auto"
MIN_WIDTH = 16  # Columns; a fourth downsampling of the network leaves one


def requested_sensor(
    name: str,
    trained: Callable[[], Sensor],
    *,
    columns: str | None = None,
    intensity_field: str | None = None,
    width: int | None = None,
    min_range: float | None = None,
    ego: str = AUTO,
    origin: Origin | None = None,
) -> Sensor | None:
    """Return the requested sensor of a network, None if nothing is requested.

    Parameters
    ----------
    name : str
        ``"auto"``, a built-in sensor, or a file. A built-in one sets noise and intensity scale
        only.
    trained : callable
        Returns the sensor of the weights.
    columns : str, optional
        Names of the columns of files without names, with commas.
    intensity_field : str, optional
        Name of the column with the intensity.
    width : int, optional
        Number of columns of the images.
    min_range : float, optional
        Range in metres below which points are the housing.
    ego : str
        Box of the vehicle, six numbers with commas, ``"none"`` or ``"auto"``.
    origin : 3 floats, optional
        Position of the sensor in the frame of the scans, in metres.

    Returns
    -------
    Sensor or None

    Raises
    ------
    UsageError
        If a request is impossible.
    """
    changes = (columns, intensity_field, width, min_range, origin)
    if (name, ego) == (AUTO, AUTO) and all(change is None for change in changes):
        return None
    chosen = _named_sensor(name, trained())
    chosen = with_names(chosen, columns, intensity_field)
    if width is not None:
        chosen = with_width(chosen, width)
    if min_range is not None:
        chosen = replace(chosen, min_range=min_range)
    if ego != AUTO:
        chosen = replace(chosen, ego_box=_ego_box(ego))
    if origin is not None:
        chosen = replace(chosen, origin=origin, registered=False)
    # The scans have another intensity and other gaps than the training.
    return replace(chosen, intensity_quantiles=(), row_gaps=None)


def _named_sensor(name: str, trained: Sensor) -> Sensor:
    """Return the sensor of a name; of a built-in one noise and intensity scale only."""
    from salsanext_cli.core.sensors.sensor import OF_DEVICE, presets
    from salsanext_cli.io.sensors import sensor

    if name == AUTO:
        return trained
    named = sensor(name, trained)
    if name not in presets():
        return named
    return replace(trained, **{key: getattr(named, key) for key in OF_DEVICE})


def with_names(sensor: Sensor, columns: str | None, intensity_field: str | None = None) -> Sensor:
    """Return a sensor with other columns of its files, or another intensity, if they are named."""
    from salsanext_cli.core.sensors.sensor import (
        COLUMNS_EXPECTED,
        FIELD_EXPECTED,
        are_columns,
        is_field,
    )

    if intensity_field is not None:
        if not intensity_field or not is_field(intensity_field):
            raise UsageError(argument("intensity_field"), quoted(intensity_field), FIELD_EXPECTED)
        sensor = replace(sensor, intensity_field=intensity_field)
    if columns is None:
        return sensor
    names = tuple(name.strip().lower() for name in columns.split(","))
    if not are_columns(names):
        raise UsageError(argument("columns"), columns, COLUMNS_EXPECTED)
    return replace(sensor, columns=names)


def with_width(sensor: Sensor, width: int) -> Sensor:
    """Return a sensor whose images have another number of columns."""
    from salsanext_cli.core.sensors.sensor import MAX_PIXELS

    most = MAX_PIXELS // sensor.height
    if not MIN_WIDTH <= width <= most:
        raise UsageError(argument("width"), str(width), f"{MIN_WIDTH} to {most} columns")
    return sensor.resized(width=width)


def _ego_box(text: str) -> tuple[float, ...]:
    """Return the numbers of a box, () for ``none``."""
    from salsanext_cli.core.sensors.sensor import BOX_EXPECTED, is_box

    box: tuple[float, ...] = ()
    if text != "none":
        with suppress(ValueError):
            box = tuple(float(number) for number in text.split(","))
        if not box or not is_box(box):
            raise UsageError(argument("ego"), text, f"auto, or {BOX_EXPECTED}")
    return box
